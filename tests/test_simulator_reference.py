"""What the judge knows of a simulated recording beyond its samples."""

from __future__ import annotations

import dataclasses
from dataclasses import asdict
from itertools import combinations

import numpy as np
import pytest

from conftest import PLUS, SMALL, exported, sizes_with
from foten.cli.simulator_reference import (
    VALIDATION_HAND,
    judged_spans_s,
    long_strokes,
    reference_for,
    validation_listener,
)
from foten.evaluate.evaluate import evaluate
from foten.evaluate.listener import N_LISTENERS
from foten.models.foten_plus.config import FotenPlusConfig
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture, texture_from_bytes
from foten.models.trainable import train
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Recording
from foten.recording.split import split_blocks
from foten.simulation.simulate import simulate
from foten.training.job import TrainingJob

CUT = PreprocessConfig(block_ms=1000)


@pytest.fixture(scope="module")
def untrained() -> Texture:
    return exported("foten", sizes_with("foten", SMALL), preprocess=asdict(CUT))


@pytest.fixture(scope="module")
def linear() -> tuple[Recording, Texture]:
    """A linear process, and what a linear fit learns of it."""
    recording = simulate("linear-cloth", 24.0, seed=1)
    config = FotenPlusConfig(epochs=0, batch=64, threads=1, max_order=20, tones=False)
    return recording, train(TrainingJob(recording, "foten-plus", FotenPlusSizes(**PLUS), config, CUT)).texture


def test_what_is_judged_is_read_with_half_a_second_around_it(linear: tuple[Recording, Texture]) -> None:
    spans = judged_spans_s(*linear)
    assert len(spans) == len(linear[1].card["split"]["test"])
    np.testing.assert_allclose(np.diff(spans).ravel(), 0.5 + 1.0 + 0.5)


def test_a_linear_process_is_predicted_at_its_bound_and_synthesized_at_its_ceiling(
    linear: tuple[Recording, Texture],
) -> None:
    recording, texture = linear
    reference = reference_for(recording, texture)
    assert len(reference.realisations) == 5
    document = evaluate(texture, recording, reference).document
    bound = document["references"]["bound_window"]["mae_scaled"]
    # Four test blocks of 840 scored samples: the mean absolute error of a Gaussian is known to 0.76/√3360 = 1.3 %.
    assert 0.96 * bound < document["references"]["ar"]["mae_scaled"] < 1.05 * bound
    assert document["references"]["bound"]["mae_scaled"] < bound
    assert document["ceiling"]["of"].startswith("5 further realisations")
    assert document["free_run"]["lsd_db"] < 1.3 * document["ceiling"]["lsd_db"]
    assert abs(document["ceiling"]["level_bias_db"]) < 1.0


def test_realisations_are_simulated_once_for_all_methods_and_anew_for_another_recording(untrained: Texture) -> None:
    recording, another = simulate("linear-hum", 8.0), simulate("linear-hum", 8.0, seed=2)
    first, again = (reference_for(recording, untrained).realisations for _ in range(2))
    assert all(one is other for one, other in zip(first, again, strict=True))
    of_another = reference_for(another, untrained).realisations
    for one, other in combinations([*first, *of_another], 2):
        assert not np.array_equal(one.acceleration, other.acceleration)
    (cut, *_) = reference_for(another, untrained, trim_ms=1000).realisations
    assert len(cut.acceleration) - len(of_another[0].acceleration) == 2000  # 1 s at each end, and not 2


def test_a_recording_that_was_not_simulated_or_cannot_be_again_has_no_truth(untrained: Texture) -> None:
    recording = simulate("linear-hum", 24.0)
    for broken in (None, {"key": "linear-hum"}, {**(recording.simulation or {}), "version": 0}):
        reference = reference_for(dataclasses.replace(recording, simulation=broken), untrained)
        assert reference.bound is None
        assert not reference.realisations
        assert ("cannot be used" in reference.why_no_bound) == (broken is not None)
    card = {"recording_sha256": recording.sha256(), "split": asdict(split_blocks(preprocess(recording, CUT)))}
    texture = dataclasses.replace(untrained, card={**untrained.card, **card})
    document = evaluate(texture, recording, reference).document
    assert document["references"]["bound"]["mae_scaled"] is None
    assert document["ceiling"]["of"] == "the training block nearest in speed and force"
    assert np.isfinite(document["ceiling"]["lsd_db"])


def test_listeners_have_true_vibrations_under_another_and_longer_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foten.cli.simulator_reference.LONG_S", 12.0)
    recording = simulate("linear-hum", 8, seed=3)
    texture = exported("foten", preprocess={"block_ms": 500.0})
    first, *others = reference_for(recording, texture, listener=True).strokes
    assert len(others) == N_LISTENERS
    for one, other in combinations((first, *others), 2):
        np.testing.assert_array_equal(one.speed, other.speed)
        assert abs(np.corrcoef(one.acceleration, other.acceleration)[0, 1]) < 0.15
    assert len(first.speed) > 1.4 * 8 * 1000 * 0.5
    own = preprocess(recording, PreprocessConfig())
    n = min(len(own.speed), len(first.speed))
    assert abs(np.corrcoef(own.speed[:n], first.speed[:n])[0, 1]) < 0.5
    assert not reference_for(recording, texture).strokes
    unknown = dataclasses.replace(recording, simulation=None)
    assert not reference_for(unknown, texture, listener=True).strokes
    assert validation_listener(texture, unknown) == {}


@pytest.fixture
def short_listener(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foten.cli.simulator_reference.LONG_S", 60.0)
    monkeypatch.setattr("foten.evaluate.listener_network.N_STEPS", 150)


@pytest.mark.usefixtures("short_listener")
def test_what_is_chosen_by_is_another_hand_and_another_place_than_what_is_reported() -> None:
    recording, texture = simulate("linear-hum", 8, seed=3), exported("foten", preprocess={"block_ms": 500.0})
    (chosen_by,), reported = long_strokes(recording, texture, 1, VALIDATION_HAND), long_strokes(recording, texture)
    assert len(reported) == 1 + N_LISTENERS
    for one in reported:
        n = min(len(one.speed), len(chosen_by.speed))
        assert abs(np.corrcoef(one.speed[:n], chosen_by.speed[:n])[0, 1]) < 0.5
        assert abs(np.corrcoef(one.acceleration[:n], chosen_by.acceleration[:n])[0, 1]) < 0.15


@pytest.mark.usefixtures("short_listener")
def test_the_area_of_a_linear_process_is_near_chance_and_of_a_louder_one_certainty(
    linear: tuple[Recording, Texture],
) -> None:
    """Of 60 s the area scatters by 0.07, as in `test_listener`; twice as loud is plain."""
    recording, texture = linear
    areas = validation_listener(texture, recording)
    assert set(areas) == {"area", "person"}
    assert max(areas.values()) < 0.75
    scaling = texture.card["scaling"]
    louder_scaling = {**scaling, "sd": [2 * scaling["sd"][0], *scaling["sd"][1:]]}
    louder = dataclasses.replace(texture, card={**texture.card, "scaling": louder_scaling})
    areas = validation_listener(texture_from_bytes(louder.to_bytes()), recording)
    assert areas["area"] > 0.95
    assert areas["person"] > 0.85  # 6 dB: Φ(2.49/√2) = 0.96
