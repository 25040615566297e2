import dataclasses

import numpy as np
import pytest

from foten.recording.scaling import Scaling, fit_scaling
from foten.recording.trace import Trace


def trace(seed: int = 0) -> Trace:
    rng = np.random.default_rng(seed)
    n = 600
    return Trace(0.3 + 2 * rng.standard_normal(n), rng.uniform(10, 200, n), rng.uniform(0.2, 3, n), 1000.0, block=100)


def test_the_training_blocks_become_standard() -> None:
    given = trace()
    scaled = fit_scaling(given, (1, 3, 4)).scale(given.stacked()).reshape(6, 100, 3)[[1, 3, 4]].reshape(-1, 3)
    np.testing.assert_allclose(scaled.mean(axis=0), 0.0, atol=1e-13)  # rounding
    np.testing.assert_allclose(scaled.std(axis=0), 1.0, rtol=1e-13)


def test_other_blocks_have_no_say() -> None:
    given = trace()
    changed = given.acceleration.copy()
    changed[:100] *= 1e3
    changed[200:300] = 7.0
    other = dataclasses.replace(given, acceleration=changed)
    assert fit_scaling(given, (1, 3, 4)) == fit_scaling(other, (1, 3, 4))
    assert fit_scaling(given, (0, 1)) != fit_scaling(other, (0, 1))


def test_the_order_of_blocks_does_not_matter() -> None:
    forwards, backwards = fit_scaling(trace(), (0, 2, 5)), fit_scaling(trace(), (5, 0, 2))
    np.testing.assert_allclose(forwards.mean + forwards.sd, backwards.mean + backwards.sd, rtol=1e-13)  # rounding


def test_scaling_and_back() -> None:
    scaling = Scaling((0.3, 90.0, 1.2), (2.0, 50.0, 0.4))
    samples = trace().stacked()
    scaled = scaling.scale(samples)
    np.testing.assert_allclose(scaling.unscale_acceleration(scaled[:, 0]), samples[:, 0], rtol=1e-13)  # rounding
    for channel in range(3):
        np.testing.assert_array_equal(scaling.scale_channel(channel, samples[:, channel]), scaled[:, channel])


def test_one_condition_still_scales_to_order_one() -> None:
    given = dataclasses.replace(trace(), speed=np.full(600, 80.0), force=np.full(600, 0.5))
    scaling = fit_scaling(given, (0, 1))
    assert scaling.mean[1:] == (80.0, 0.5)
    assert scaling.sd[1:] == (80.0, 1.0)


@pytest.mark.parametrize("value", [0.0, 9.81, 1e6])
def test_a_constant_acceleration_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match=r"acceleration is constant.*right column"):
        fit_scaling(dataclasses.replace(trace(), acceleration=np.full(600, value)), (0, 1))


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize(("channel", "name"), list(enumerate(["acceleration", "speed", "force"])))
def test_a_scale_is_positive_and_finite(bad: float, channel: int, name: str) -> None:
    sd = [1.0, 1.0, 1.0]
    sd[channel] = bad
    with pytest.raises(ValueError, match=f"{name} has mean 0.0 and standard deviation"):
        Scaling((0.0, 0.0, 0.0), tuple(sd))  # type: ignore[arg-type]
