"""What experiments measure of a texture file beside its evaluation: stability, first strokes, the shape of chance."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import quad

from conftest import exported
from foten.datasets.simulate import simulate
from foten.experiments.experiment import MEASURES, Experiment, Method
from foten.experiments.innovations import KINDS, innovations
from foten.experiments.onset import onset
from foten.experiments.run import _judged, _measures
from foten.experiments.stability import into, proven, stability
from foten.families import FotenPlusSizes
from foten.families.texture_file import Texture
from foten.recording.trace import Trace


@pytest.fixture(scope="module")
def texture() -> Texture:
    texture = exported("foten-plus", FotenPlusSizes(order=20, network_in_loop=False))
    metrics = {**texture.card["metrics"], "recorded_peak_sd": 4.0}
    return dataclasses.replace(texture, card={**texture.card, "metrics": metrics})


def test_a_texture_is_bounded_and_forgets(texture: Texture) -> None:
    figures = stability(texture, minutes=0.5, n_attack=12_000)
    assert figures["finite"]
    assert figures["n_samples"] == 30_000
    assert figures["still_m_s2"] == 0.0
    assert figures["attack_later_max_sd"] <= figures["attack_bound_sd"]
    assert figures["attack_max_sd"] > figures["attack_later_max_sd"]
    assert 0 < figures["forgets_s"] < 12
    assert figures["attack_after_db"] < 0.5


def test_the_proven_bound_grows_with_the_level(texture: Texture) -> None:
    tensors = {**texture.tensors, "lattice.level.highest": 2 * texture.tensors["lattice.level.highest"]}
    assert proven(dataclasses.replace(texture, tensors=tensors)) == pytest.approx(2 * proven(texture))
    assert proven(exported("foten")) is None


def test_strokes_are_stretched_each_by_itself() -> None:
    stretched = into(np.array([[0.0, 1.0, 2.0], [5.0, 5.5, 7.0]]), 10.0, 20.0)
    np.testing.assert_allclose(stretched, [[10.0, 15.0, 20.0], [10.0, 12.5, 20.0]])


def test_a_first_stroke_is_as_a_settled_one(texture: Texture) -> None:
    figures = onset(texture, n_strokes=12, n_streams=6)
    # 72 windows of 40 ms: what ten settled ones reach at most, and half as much again.
    for name in ("level_db", "spectrum_db", "level_size_db"):
        for start in ("0_ms", "20_ms", "60_ms", "100_ms"):
            assert abs(figures[name][start]) < 1.5 * figures[name]["settled"] + 0.2
    excess = figures["click_share"] - figures["settled_share"]
    assert abs(excess) < 4 * figures["click_standard_error"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_density_integrates_to_one(kind: str) -> None:
    density, start = KINDS[kind]
    total, _ = quad(lambda u: float(np.exp(density(np.array([u]), *start))[0]), -60, 60, limit=400, points=[0.0])
    assert total == pytest.approx(1.0, abs=1e-4)  # a Student t of 4.7 degrees of freedom has 3e-7 beyond


def test_innovations_are_of_excited_textures_without_tones(texture: Texture) -> None:
    rng = np.random.default_rng(0)
    n = texture.card["split"]["n_blocks"] * texture.card["split"]["block"]
    low, high = texture.trained_range("speed")
    trace = Trace(
        texture.scaling.sd[0] * rng.standard_normal(n), np.full(n, (low + high) / 2), np.ones(n), 1000.0,
        texture.card["split"]["block"],
    )  # fmt: skip
    nats = innovations(texture, trace)
    assert set(nats) == set(KINDS)
    assert nats["heavy_tailed"] == pytest.approx(nats["gaussian"], abs=0.02)  # Gaussian noise has no tails to gain by
    assert innovations(exported("foten"), trace) == {}


def test_every_measure_that_a_file_may_name_is_there(texture: Texture, monkeypatch: pytest.MonkeyPatch) -> None:
    own = [name for name in MEASURES if name != "listener"]  # which the evaluation asks
    for name in own:
        monkeypatch.setattr(f"foten.experiments.run.{name}", lambda *_, name=name: {"named": name})
    assert _measures(MEASURES, texture, None, None) == {name: {"named": name} for name in own}  # type: ignore[arg-type]


@pytest.mark.parametrize("measures", [(), ("stability", "listener")])
def test_the_listener_is_asked_where_a_file_names_it(
    texture: Texture, monkeypatch: pytest.MonkeyPatch, measures: tuple[str, ...]
) -> None:
    asked: dict[str, bool] = {}

    class EnoughError(Exception):
        pass

    def evaluated(*_: object, listener: bool) -> None:
        asked["evaluation"] = listener
        raise EnoughError

    monkeypatch.setattr("foten.experiments.run.truth_for", lambda *_, listener: asked.update(truth=listener))
    monkeypatch.setattr("foten.experiments.run.evaluate", evaluated)
    run = next(iter(Experiment("t", ("linear-hum",), (Method("foten", measures=measures),)).runs()))
    with pytest.raises(EnoughError):
        _judged(run, simulate("linear-hum", 4), texture, 0.0)
    assert asked == {"truth": "listener" in measures, "evaluation": "listener" in measures}
