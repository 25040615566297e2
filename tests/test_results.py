"""Which differences between methods are significant."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import false_discovery_control

from foten.experiments.results import Row, compared, holm


def test_holm_is_at_least_as_strict_as_the_false_discovery_rate_and_never_above_bonferroni() -> None:
    """By hand for three; beside SciPy's Benjamini–Hochberg, which is always more lenient."""
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    p = np.random.default_rng(0).uniform(size=9).tolist()
    corrected = np.array(holm(p))
    assert (corrected >= false_discovery_control(p) - 1e-12).all()
    assert (corrected <= np.minimum(1, 9 * np.array(p)) + 1e-12).all()


def test_what_is_never_better_differs_and_what_is_the_same_does_not() -> None:
    textures = [f"T{i}" for i in range(12)]
    rng = np.random.default_rng(1)
    base = rng.uniform(0.2, 0.6, 12)
    values = {"best": base, "same": base + rng.normal(0, 0.01, 12) + 0.001, "worse": base + 0.1}
    rows = [Row(name, "m", dict(zip(textures, v[:, None], strict=True))) for name, v in values.items()]
    best, p = compared(rows, textures, -1)
    assert best == "best"
    assert p["worse"] < 0.01
    assert p["same"] > 0.05
    assert compared(rows, textures[:5], -1)[1] == {}
