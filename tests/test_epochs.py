from dataclasses import replace

import pytest

from foten.train.config import RECIPES
from foten.train.epochs import Epoch, Progress, goes_on

CONFIG = replace(RECIPES["default"], probation=3, least_gain=1e-3, patience=4)


def progress(errors: list[float]) -> Progress:
    """Return what has been after some epochs, from epoch 0 on, given their validation errors."""
    best = min(range(len(errors)), key=errors.__getitem__)
    lines = [Epoch(n, 1.0, error, error, 0.1, n == best or n == 0) for n, error in enumerate(errors)]
    return Progress(lines, best_loss=errors[best])


def test_a_network_that_gains_nothing_is_stopped_at_the_end_of_its_probation_and_says_so() -> None:
    assert goes_on(progress([1.0]), CONFIG)
    assert goes_on(progress([1.0, 0.9999, 0.9998]), CONFIG)
    given = progress([1.0, 0.9999, 0.9998, 0.9995])
    assert not goes_on(given, CONFIG)
    assert given.notes == [
        "the network gains 0.05 % on the validation blocks in 3 epochs, less than 0.1 %: its training stops there"
    ]


@pytest.mark.parametrize("errors", [[1.0, 1.0, 0.9985, 1.0], [1.0, 0.9, 0.8, 0.7]])
def test_a_network_that_gained_something_goes_on(errors: list[float]) -> None:
    given = progress(errors)
    assert goes_on(given, CONFIG)
    assert not given.notes


def test_patience_ends_what_probation_let_pass() -> None:
    assert goes_on(progress([1.0, 0.9, 0.91, 0.92, 0.93]), CONFIG)
    assert not goes_on(progress([1.0, 0.9, 0.91, 0.92, 0.93, 0.94]), CONFIG)


def test_the_papers_recipe_has_no_probation() -> None:
    paper = RECIPES["paper"]
    assert paper.probation > paper.epochs
