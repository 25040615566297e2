"""The reference: the networks that PyTorch trains, and a closed loop that is the one of Sec. V."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import torch

from conftest import PLUS, SMALL, exported, sizes_with, untrained
from foten.models.definitions import model_of
from foten.models.foten.definition import Network
from foten.models.foten.sizes import TransformerSizes
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.stream import run
from foten.models.trainable import TRAINABLE
from foten.training.texture_builder import tensors_of

VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "post-norm": {**SMALL, "pre_norm": False},
    "literal-width": {**SMALL, "spectral_width": 1},
    "literal-width-post-norm": {**SMALL, "spectral_width": 1, "pre_norm": False},
    "window-5": {**SMALL, "window": 5},
    "window-30": {**SMALL, "window": 30},
    "one-layer": {**SMALL, "n_layers": 1},
    "one-head": {**SMALL, "n_heads": 1},
    "half-of-the-bins": {**SMALL, "bins": "half"},
    "half-of-odd-bins": {**SMALL, "bins": "half", "window": 9},
    "excited": {**SMALL, "excitation": True},
}
"""Of every network."""
PLUS_VARIANTS: dict[str, dict[str, Any]] = {
    "small": PLUS,
    "one-component": {**PLUS, "n_components": 1},
    "order-7": {**PLUS, "order": 7},
    "a-table": {**PLUS, "order": 7, "n_speed": 4, "n_force": 3},
    "tones": {**PLUS, "order": 5, "n_tones": 3, "n_tone_speed": 5, "n_tone_force": 2, "residual_order": 8},
    "gain-before": {**PLUS, "order": 7, "n_speed": 4, "n_force": 3, "gain_before_filter": True},
    "equalised": {**PLUS, "order": 7, "equalised": True},
    "equalised-tones": {**PLUS, "n_tones": 2, "residual_order": 6, "equalised": True},
    "gain-before-of-the-residual": {**PLUS, "n_tones": 2, "residual_order": 6, "residual_gain_before_filter": True},
    "gain-before-of-one-of-two": {**PLUS, "order": 5, "n_tones": 2, "residual_order": 6, "gain_before_filter": True},
    "tones-on-a-table": {**PLUS, "n_tones": 2, "n_tone_speed": 4, "n_residual_speed": 3, "n_residual_force": 2},
    # Layers as wide as they are trained, and some that end a little after a panel of 16.
    "usual-widths": {"window": 12, "n_tones": 2, "residual_order": 6},
    "widths-of-no-panel": {"window": 12, "n_hidden": 10, "head_width": 17, "n_components": 7, "n_tones": 1},
}
"""Of foten-plus."""


def cases() -> list[tuple[str, str]]:
    """Each family that the kernel runs but the piecewise one, with each variant that it has."""
    pairs = []
    for key in ("foten", "ten"):
        known = {one.name for one in fields(TRAINABLE[key].sizes)}
        pairs += [(key, name) for name, wanted in VARIANTS.items() if set(wanted) - set(SMALL) <= known]
    pairs = [(key, name) for key, name in pairs if key != "ten" or "literal" not in name]
    return [*pairs, *(("foten-plus", name) for name in ("default", *PLUS_VARIANTS))]


CASES = cases()


def sizes_for(key: str, variant: str) -> Any:
    """The sizes of a case."""
    return sizes_with(key, {**VARIANTS, **PLUS_VARIANTS}[variant])


def network_windows(sizes: TransformerSizes) -> np.ndarray:
    """Windows for a network: chance, loud and soft, silence, and spectra of one bin."""
    rng = np.random.default_rng(0)
    m, n_channels = sizes.window, 3
    rows = rng.standard_normal((60, m, n_channels))
    constant = np.repeat(rng.standard_normal((5, 1, n_channels)), m, axis=1)
    alternating = 0 * rows[:5]
    alternating[:, :, 0] = (-1.0) ** np.arange(m)  # Nyquist alone, on the negative axis for odd phase
    revived = np.repeat(rng.uniform(-0.01, 0.01, (20, 1, n_channels)), m, axis=1)
    revived[:, 0, 0] -= rng.uniform(1e-4, 0.01, 20)  # before a silence: every bin lies on the negative axis, or nearly
    others = [0 * rows[:1], constant, -constant, alternating, revived]
    return np.concatenate([rows, 10 * rows[:5], 1e-6 * rows[:5], *others])


@pytest.mark.parametrize(("key", "variant"), [case for case in CASES if case[0] != "foten-plus"])
def test_its_network_is_pytorchs(key: str, variant: str) -> None:
    """Seam: PyTorch in float64 on the same tensors, pruned, where this one leaves nothing out."""
    sizes = sizes_for(key, variant)
    network = untrained(key, sizes)
    windows = network_windows(sizes)
    with torch.no_grad():
        expected = network.double()(torch.from_numpy(windows)).numpy()
    result = Network(sizes, tensors_of(network))(windows)
    assert expected.std() > 1e-3
    # Rounding of float64 in sums of another order, through six layers; √(|Z|² + 1e-16) has a steep slope at nothing.
    np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-9)


def test_bins_that_hold_only_rounding_have_no_phase() -> None:
    """Constant and alternating windows leave empty bins; 1e-9 of a change must not turn their phases."""
    sizes = sizes_with("foten", SMALL)
    network = Network(sizes, tensors_of(untrained("foten", sizes)))
    signs = np.where(np.arange(sizes.window) % 2, -1.0, 1.0)
    for shape in (np.ones(sizes.window), signs):
        windows = np.zeros((1, sizes.window, 3))
        windows[0, :, 0] = 12 * shape
        # A turned phase moves it by 4e-3 and more.
        assert network(windows) == pytest.approx(network(windows * (1 + 1e-9)), abs=1e-7)


@pytest.mark.parametrize("variant", ["default", "excited", "a-table", "tones"])
def test_it_is_stateless_and_takes_windows_in_any_number(variant: str) -> None:
    key = "foten-plus" if variant in PLUS_VARIANTS else "foten"
    sizes = sizes_for(key, variant)
    model = model_of(sizes, exported(key, sizes).tensors)
    windows = np.random.default_rng(0).standard_normal((9, sizes.history, 3))
    before = windows.copy()
    at_once = model.predict(windows)
    alone = np.concatenate([model.predict(window[None]) for window in windows[::-1]])[::-1]
    # Products of other shapes sum in another order, in float64.
    np.testing.assert_allclose(alone, at_once, rtol=1e-10, atol=1e-12)
    np.testing.assert_array_equal(windows, before)


@pytest.mark.parametrize("sizes", [{"order": 6}, {"n_tones": 2, "residual_order": 6}])
def test_what_a_stream_begins_with_is_chance_alone(sizes: dict[str, Any]) -> None:
    """Not the window that it was started with, network and tones included; another seed, another beginning."""
    family = FotenPlusSizes(**{**PLUS, **sizes})
    model = model_of(family, exported("foten-plus", family).tensors)
    rng = np.random.default_rng(3)
    condition = np.array([[0.3, -0.2, 118.0], [1.0, 0.5, 160.0]])
    streams: list[Any] = [model.start(rng.standard_normal((2, family.history, 3))) for _ in range(3)]
    noise = rng.standard_normal((2, streams[0].n_initial))
    for stream, drawn in zip(streams, (noise, noise, -noise), strict=True):
        stream.begin(condition, drawn)
    one, same, other = (run(stream, np.tile(condition[:, None], (1, 50, 1)), None) for stream in streams)
    np.testing.assert_array_equal(one, same)
    assert (one[:, 0] != other[:, 0]).all()


def test_a_prediction_may_be_taken_twice() -> None:
    sizes = FotenPlusSizes(**{**PLUS, "n_tones": 2})
    model = model_of(sizes, exported("foten-plus", sizes).tensors)
    stream = model.start(np.random.default_rng(0).standard_normal((2, sizes.history, 3)))
    np.testing.assert_array_equal(stream.predict().sample, stream.predict().sample)
