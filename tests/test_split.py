import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foten.recording.split import METHODS, Split, split_blocks
from foten.recording.trace import Trace

BLOCK = 10


def trace(n_blocks: int, seed: int = 0) -> Trace:
    """Trace whose blocks each have their own speed and force."""
    rng = np.random.default_rng(seed)
    speed, force = rng.uniform(10, 200, n_blocks), rng.uniform(0.2, 3, n_blocks)
    ripple = np.tile(np.linspace(-1, 1, BLOCK), n_blocks)
    return Trace(
        rng.standard_normal(n_blocks * BLOCK),
        np.repeat(speed, BLOCK) + ripple,
        np.repeat(force, BLOCK) + 0.1 * ripple,
        1000.0,
        BLOCK,
        recording_sha256="abc",
    )


def parts(split: Split) -> tuple[set[int], set[int], set[int]]:
    return set(split.train), set(split.validation), set(split.test)


@pytest.mark.parametrize("method", METHODS)
@given(n_blocks=st.integers(5, 120), seed=st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_every_block_has_one_part_and_the_totals_are_60_20_20(method: str, n_blocks: int, seed: int) -> None:
    split = split_blocks(trace(n_blocks, seed), method, seed)
    every = [*split.train, *split.validation, *split.test]
    assert sorted(every) == list(range(n_blocks))  # disjoint and complete
    for part in (split.validation, split.test):
        assert abs(len(part) - 0.2 * n_blocks) <= 0.5  # the nearest whole number
    assert len(split.train) >= len(split.test)


@given(n_blocks=st.integers(8, 60), seed=st.integers(0, 1000))
@settings(max_examples=30, deadline=None)
def test_the_extremes_of_speed_and_force_train(n_blocks: int, seed: int) -> None:
    given_trace = trace(n_blocks, seed)
    train = parts(split_blocks(given_trace, seed=seed))[0]
    for channel in (given_trace.speed, given_trace.force):
        means = given_trace.blocks(channel).mean(axis=1)
        assert {int(means.argmin()), int(means.argmax())} <= train


@pytest.mark.parametrize(("n_blocks", "n_groups"), [(8, 2), (16, 2), (18, 3), (45, 3)])
def test_every_group_of_speed_and_of_force_within_it_is_held_out(n_blocks: int, n_groups: int) -> None:
    """Oracle: the cells from the means. Dealt in turn, each gives a block as soon as there are as many to hold out as cells."""
    for seed in range(20):
        of_seed = trace(n_blocks, seed)
        speed, force = (of_seed.blocks(channel).mean(axis=1) for channel in (of_seed.speed, of_seed.force))
        extremes = {int(i) for means in (speed, force) for i in (means.argmin(), means.argmax())}
        split = split_blocks(of_seed, seed=seed)
        held_out = {*split.validation, *split.test}
        cells = [
            {int(i) for i in cell} - (extremes if n_blocks - len(extremes) >= len(held_out) else set())
            for group in np.array_split(np.argsort(speed), n_groups)
            for cell in np.array_split(group[np.argsort(force[group])], n_groups)
        ]
        empty = sum(not cell & held_out for cell in cells if cell)
        assert empty == max(0, sum(map(bool, cells)) - len(held_out))
        if n_blocks == 45:
            assert all(cell & set(split.test) and cell & set(split.validation) for cell in cells)


def test_contiguous_parts_are_one_stretch_each_in_order() -> None:
    split = split_blocks(trace(20), "contiguous")
    assert (split.train, split.validation, split.test) == (tuple(range(12)), tuple(range(12, 16)), tuple(range(16, 20)))


def test_a_seed_is_a_split_whatever_the_acceleration() -> None:
    of_noise = trace(28)
    louder = dataclasses.replace(of_noise, acceleration=of_noise.acceleration[::-1] ** 2)
    assert split_blocks(of_noise, seed=1) == split_blocks(louder, seed=1)
    assert split_blocks(of_noise, seed=1).test != split_blocks(of_noise, seed=2).test


@pytest.mark.parametrize(
    ("n_blocks", "method", "message"),
    [
        (4, "regrouped", r"4 blocks of 10 ms, expected 5 or more.*--block and --trim"),
        (10, "random", "'random', expected one of regrouped, contiguous"),
    ],
)
def test_what_cannot_be_split_is_refused(n_blocks: int, method: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        split_blocks(trace(n_blocks), method)


def test_the_digest_is_of_everything() -> None:
    split = split_blocks(trace(28))
    changed = [
        dataclasses.replace(split, seed=1),
        dataclasses.replace(split, method="contiguous"),
        dataclasses.replace(split, block=11),
        dataclasses.replace(split, n_blocks=29),
        dataclasses.replace(split, recording_sha256="abd"),
        dataclasses.replace(split, test=split.validation, validation=split.test),
        dataclasses.replace(split, train=split.train[:-1]),
    ]
    assert len({s.sha256() for s in (split, *changed)}) == 1 + len(changed)


def test_json_round_trip(tmp_path: Path) -> None:
    split = split_blocks(trace(28), seed=5)
    assert Split.from_fields(json.loads(json.dumps(dataclasses.asdict(split)))) == split
    split.save(tmp_path / "split.json")
    document = json.loads((tmp_path / "split.json").read_text())
    assert document.pop("sha256") == split.sha256() == Split.from_fields(document).sha256()
    assert [path.name for path in tmp_path.iterdir()] == ["split.json"]
