"""The envelope of a texture's random part: as rough as it is asked to be, of the same power, proved by the kernel."""

import numpy as np
import pytest

from conftest import PLUS, exported
from foten.baselines.sizes import TRAINABLE
from foten.editing.describe import rendered, steady_figures
from foten.editing.edit import Edit, edited
from foten.editing.envelope import STRENGTHS, EnvelopeCurve, with_envelope
from foten.models.texture_file import read_texture
from foten.runtime.renderer import EXAMPLE

TOWEL = EXAMPLE.parent / "towel.foten"


@pytest.mark.parametrize("n_tones", [0, 2])
def test_a_texture_without_a_network_gets_one_that_does_this_alone(n_tones: int) -> None:
    """Log-normal volatility: kurtosis 3 exp(4 s²) of what was Gaussian, whose mean square stays."""
    sizes = TRAINABLE["foten-plus"](
        **PLUS, order=2, network_in_loop=False, n_tones=n_tones, residual_order=2 if n_tones else 1
    )
    silent = {} if not n_tones else {"tones.values": np.zeros((1, 2 * n_tones))}
    white = {f"{part}.reflections": np.zeros((1, 2)) for part in (["lattice", "residual"] if n_tones else ["lattice"])}
    texture = exported(
        "foten-plus", sizes, tensors={**silent, **white, "excitation.innovation_limit": np.array([50.0, 1e3])}
    )
    before = rendered(texture, 100.0, 0.7, 400.0)
    strength = 0.4
    after = rendered(with_envelope(texture, strength), 100.0, 0.7, 400.0)
    assert np.mean(before**4) / np.mean(before**2) ** 2 == pytest.approx(3.0, rel=0.03)
    assert np.mean(after**2) == pytest.approx(np.mean(before**2), rel=0.06)
    # h is nearly normal; tanh and the drive's mean square move its size by a tenth.
    assert np.mean(after**4) / np.mean(after**2) ** 2 == pytest.approx(3 * np.exp(4 * strength**2), rel=0.2)


def test_what_varies_is_slow() -> None:
    """The envelope's correlation falls to 1/e within the unit's time constant, 50 ms."""
    texture = exported(
        "foten-plus",
        TRAINABLE["foten-plus"](**PLUS, order=2, network_in_loop=False),
        tensors={"lattice.reflections": np.zeros((1, 2))},
    )
    signal = rendered(with_envelope(texture, 0.7), 100.0, 0.7, 200.0)
    power = np.log(np.square(signal).reshape(-1, 10).mean(axis=1))  # frames of 10 ms
    power -= power.mean()
    correlation = [np.mean(power[: power.size - lag] * power[lag:]) for lag in (1, 6)]
    assert correlation[1] / correlation[0] == pytest.approx(np.exp(-1.0), abs=0.12)


@pytest.mark.parametrize("rougher_db", [-0.1, 0.5, 1.5])
def test_an_edit_makes_a_texture_as_rough_as_asked(rougher_db: float) -> None:
    result = edited(read_texture(TOWEL), Edit(rougher=rougher_db))
    before, after = result.before, result.after
    assert after.roughness_db - before.roughness_db == pytest.approx(rougher_db, abs=0.15)
    assert after.level_db == pytest.approx(before.level_db, abs=0.01)
    assert np.log2(after.centroid_hz / before.centroid_hz) == pytest.approx(0, abs=0.05)
    assert after.width_octaves == pytest.approx(before.width_octaves, abs=0.05)
    assert not result.unreached
    assert f"roughness {rougher_db:+g} dB" in result.texture.evidence


def test_noise_has_an_envelope_of_its_own_and_that_is_said() -> None:
    result = edited(read_texture(TOWEL), Edit(rougher=-2.0))
    assert -0.5 < result.after.roughness_db - result.before.roughness_db < 0
    assert result.unreached[-1].startswith("the roughness is ")


def test_roughness_rises_with_the_strength() -> None:
    texture = read_texture(TOWEL)
    curve = EnvelopeCurve(texture)
    assert (np.diff(curve.roughness_db) >= 0).all()
    assert curve.roughness_db[STRENGTHS.index(0.0)] == steady_figures(texture).roughness_db
    assert curve.strength(0.0) == 0.0
    assert curve.strength(99.0) == 1.0
    assert with_envelope(texture, 0.0) is texture
