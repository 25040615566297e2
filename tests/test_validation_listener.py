"""What is chosen by is another hand than what is reported, and knows a texture from a wrong one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from conftest import exported
from foten.datasets.simulate import simulate
from foten.evaluate.listener import N_LISTENERS
from foten.experiments.truth import long_strokes
from foten.experiments.validation_listener import HAND_NUMBER, validation_listener
from foten.families import sizes_of
from foten.families.texture_file import texture_from_bytes
from foten.train.config import recipe_of
from foten.train.job import TrainingJob
from foten.train.pipeline import train

pytest.importorskip("torch")


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("foten.experiments.truth.LONG_S", 60.0)
    monkeypatch.setattr("foten.networks.listener.N_STEPS", 150)


def test_its_hand_and_places_are_not_those_of_the_reported_figures() -> None:
    recording, texture = simulate("linear-hum", 8, seed=3), exported("foten", preprocess={"block_ms": 500.0})
    (chosen_by,), reported = long_strokes(recording, texture, 1, HAND_NUMBER), long_strokes(recording, texture)
    assert len(reported) == 1 + N_LISTENERS
    for one in reported:
        n = min(len(one.speed), len(chosen_by.speed))
        assert abs(np.corrcoef(one.speed[:n], chosen_by.speed[:n])[0, 1]) < 0.5
        assert abs(np.corrcoef(one.acceleration[:n], chosen_by.acceleration[:n])[0, 1]) < 0.15


def test_the_area_of_a_linear_process_is_near_chance_and_of_a_louder_one_certainty() -> None:
    """Of 60 s the area scatters by 0.07, as in `test_listener`; twice as loud is plain."""
    recording = simulate("linear-cloth", 30, seed=1)
    config = recipe_of("foten-plus", threads=1, epochs=0, volatility=False, tails=False)
    texture = train(TrainingJob(recording, "foten-plus", sizes_of("foten-plus", {}), config)).texture
    assert validation_listener(texture, recording)["area"] < 0.75
    scaling = texture.card["scaling"]["sd"]
    louder = dataclasses.replace(
        texture, card={**texture.card, "scaling": {**texture.card["scaling"], "sd": [2 * scaling[0], *scaling[1:]]}}
    )
    assert validation_listener(texture_from_bytes(louder.to_bytes()), recording)["area"] > 0.95


def test_of_a_recording_it_says_nothing() -> None:
    recording = dataclasses.replace(simulate("linear-hum", 8), simulation=None)
    assert validation_listener(exported("foten", preprocess={"block_ms": 500.0}), recording) == {}
