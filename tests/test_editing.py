"""Textures as values: what is described is what is rendered, an edit reaches what it asks for, a blend lies between."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import PLUS as SMALL_PLUS
from conftest import exported, resonance, scale
from foten.cli.command_line import _status
from foten.dsp.lattice import reflections_of
from foten.dsp.speed_force_table import SpeedForceTable
from foten.editing import blend as blending
from foten.editing.describe import Description, describe, rendered, spectrum, steady_figures
from foten.editing.edit import Edit, edited
from foten.editing.envelope import STRENGTHS, EnvelopeCurve, with_envelope
from foten.editing.warp import Warp, reflections_for, spectra_of, warped_reflections, warped_tones
from foten.models.texture_file import Texture, read_texture
from foten.models.trainable import TRAINABLE
from foten.recording.scaling import Scaling
from foten.runtime.renderer import EXAMPLE, Renderer

FOLDER = EXAMPLE.parent
PLUS = [path.stem for path in sorted(FOLDER.glob("*.foten")) if not path.stem.endswith("_ar")]
WITHOUT_TONES, WITH_TONES = "towel", "jeans"


@pytest.fixture(scope="module")
def textures() -> dict[str, Texture]:
    return {name: read_texture(FOLDER / f"{name}.foten") for name in PLUS}


@pytest.fixture(scope="module")
def descriptions(textures: dict[str, Texture]) -> dict[str, Description]:
    return {name: describe(texture) for name, texture in textures.items()}


def test_a_description_is_of_what_is_rendered(
    textures: dict[str, Texture], descriptions: dict[str, Description]
) -> None:
    """Centroid and width by a sum over a plain periodogram, the level by the samples."""
    name = WITHOUT_TONES
    signal = Renderer(textures[name], seed=0).render(100.0, 0.7, round(16.5 * textures[name].rate_hz))[500:]
    one = descriptions[name]
    assert one.level_db == pytest.approx(10 * np.log10(np.mean(np.square(signal, dtype=np.float64))), abs=1e-6)
    power, hz = np.abs(np.fft.rfft(signal)) ** 2, np.fft.rfftfreq(signal.size, 1 / textures[name].rate_hz)
    inside = (hz >= 20) & (hz <= 0.45 * textures[name].rate_hz)
    mean = np.average(np.log2(hz[inside]), weights=power[inside])
    sd = np.sqrt(np.average((np.log2(hz[inside]) - mean) ** 2, weights=power[inside]))
    assert one.centroid_hz == pytest.approx(2**mean, rel=0.03)  # bins of 5 Hz
    assert one.width_octaves == pytest.approx(sd, abs=0.03)
    assert one.period_mm is None
    assert descriptions[WITH_TONES].period_mm == pytest.approx(0.9, abs=0.01)  # of the simulated weave


def test_exponents_are_those_of_the_levels(textures: dict[str, Texture], descriptions: dict[str, Description]) -> None:
    texture = textures[WITHOUT_TONES]
    levels = [20 * np.log10(rendered(texture, v, 0.7, 30.0, seed=5).std()) for v in (70.7, 141.4)]
    assert descriptions[WITHOUT_TONES].speed_exponent == pytest.approx((levels[1] - levels[0]) / 6.02, abs=0.1)


@pytest.mark.parametrize("name", [WITHOUT_TONES, WITH_TONES, "steel-mesh-1_ar"])
def test_a_louder_texture_is_the_same_samples_multiplied(name: str) -> None:
    texture = read_texture(FOLDER / f"{name}.foten")
    louder = edited(texture, Edit(level_db=6.0)).texture
    plain, loud = (Renderer(one, seed=3).render(90.0, 0.8, 3000) for one in (texture, louder))
    np.testing.assert_allclose(loud, plain * 10**0.3, rtol=2e-6, atol=1e-6)
    assert louder.evidence == "edited: level +6 dB, not measured"


@pytest.mark.parametrize(
    ("name", "edit"),
    [
        pytest.param(WITHOUT_TONES, Edit(brighter=0.5), marks=pytest.mark.slow),
        (WITHOUT_TONES, Edit(level_db=-3.0, brighter=-0.5, wider=0.2)),
        pytest.param(WITHOUT_TONES, Edit(wider=-0.2), marks=pytest.mark.slow),
        (WITH_TONES, Edit(brighter=0.5)),
        pytest.param("textured-rubber", Edit(brighter=1.0), marks=pytest.mark.slow),
        (WITHOUT_TONES, Edit(speed_exponent=0.5, force_exponent=0.8)),
        (WITH_TONES, Edit(speed_exponent=0.5, force_exponent=0.8)),  # of the tones and of what they leave
    ],
)
def test_an_edit_reaches_what_it_asks_for(
    textures: dict[str, Texture], descriptions: dict[str, Description], name: str, edit: Edit
) -> None:
    before, after = descriptions[name], describe(edited(textures[name], edit).texture)
    assert after.level_db - before.level_db == pytest.approx(edit.level_db, abs=0.01)
    assert np.log2(after.centroid_hz / before.centroid_hz) == pytest.approx(edit.brighter, abs=0.05)
    assert after.width_octaves - before.width_octaves == pytest.approx(edit.wider, abs=0.05)
    if edit.speed_exponent is not None:
        assert after.speed_exponent == pytest.approx(edit.speed_exponent, abs=0.02)
        assert after.force_exponent == pytest.approx(edit.force_exponent, abs=0.02)


def test_what_an_edit_cannot_reach_is_said(textures: dict[str, Texture]) -> None:
    """The rate of 1 kHz ends the spectrum, and a grass that is brighter by 1.5 octaves would lie beyond."""
    result = edited(textures["artificial-grass"], Edit(brighter=1.5))
    assert result.unreached
    assert result.unreached[0].startswith("the centroid is ")


@pytest.mark.parametrize("period_mm", [0.6, 1.2])
def test_another_period_moves_the_tones(textures: dict[str, Texture], period_mm: float) -> None:
    """v/λ Hz, at two speeds."""
    texture = edited(textures[WITH_TONES], Edit(period_mm=period_mm)).texture
    for speed in (60.0, 120.0):
        hz, density = spectrum(rendered(texture, speed, 0.7, 20.0), texture.rate_hz)
        near = np.abs(hz - speed / period_mm) < 15
        assert abs(hz[near][np.argmax(density[near])] - speed / period_mm) <= 5  # a bin
        assert density[near].max() > 3 * np.median(density[np.abs(hz - speed / period_mm) < 60])


def test_a_warp_moves_power_and_keeps_it() -> None:
    hz = np.linspace(0, 5000, 20_001)
    density = np.exp(-0.5 * (np.log2(np.maximum(hz, 1) / 200) / 0.3) ** 2) / np.maximum(hz, 1)
    moved = Warp(200.0, octaves=1.0, stretch=1.5).density(hz, density)
    assert moved.sum() == pytest.approx(density.sum(), rel=1e-3)
    octave = np.log2(np.maximum(hz, 1))
    mean = np.average(octave, weights=moved)
    assert mean == pytest.approx(np.log2(400), abs=1e-3)
    assert np.sqrt(np.average((octave - mean) ** 2, weights=moved)) == pytest.approx(0.45, abs=2e-3)
    np.testing.assert_allclose(Warp(200.0).density(hz, density)[20:], density[20:], 1e-9, 1e-9 * density.max())


def test_a_warped_resonance_is_a_resonance_elsewhere() -> None:
    taps = resonance(120.0, 0.97, 12)
    reflections = reflections_of(np.concatenate([[1.0], -taps[::-1]])[None])
    up = warped_reflections(reflections, 1000.0, Warp(120.0, octaves=1.0))
    assert np.abs(up).max() < 1
    peak = np.linspace(0, 500, spectra_of(up).shape[1])[np.argmax(spectra_of(up)[0])]
    assert peak == pytest.approx(240, abs=3)
    same = warped_reflections(reflections, 1000.0, Warp(120.0))
    shapes = [spectrum / spectrum.sum() for spectrum in (*spectra_of(same), *spectra_of(reflections))]
    np.testing.assert_allclose(*shapes, rtol=0.02)  # the lattice's leak, which widens a resonance by 0.1 Hz


def test_reflections_are_stable_for_any_spectrum() -> None:
    rng = np.random.default_rng(0)
    density = np.exp(rng.normal(0, 6, (20, 8193)))  # over 100 dB
    density[3:6, 2000:] = 0.0
    assert np.abs(reflections_for(density, 80)).max() < 1


def test_the_envelope_of_tones_is_warped() -> None:
    """Three multiples of 100 Hz that fall by 12 dB an octave, an octave up: each as loud as what lies an octave below it."""
    sizes = np.array([1.0, 0.25, 1 / 9])
    amplitudes = np.stack([sizes * 0.6, sizes * 0.8], axis=1).reshape(1, 6)
    up = warped_tones(amplitudes, np.array([100.0]), Warp(100.0, octaves=1.0)).reshape(3, 2)
    np.testing.assert_allclose(np.hypot(*up.T), [0.25, 1.0, 0.4444], rtol=0.02)
    np.testing.assert_allclose(up[:, 0] / up[:, 1], 0.75)  # phases stay


def test_a_rescaled_scale_is_the_same_over_speed_and_force() -> None:
    one = scale(16, 0.7, seed=1)
    one = replace(one, exponents=np.array([0.9, 0.3, -0.1, 0.05, 0.2]), sigma_max=np.array([1e6]))
    other = Scaling(mean=(0.0, 70.0, 2.0), sd=(1.0, 11.0, 0.4))
    physical = np.random.default_rng(2).uniform([1.0, 0.05], [300.0, 4.0], (200, 2))
    again = blending.rescaled(one, other)
    np.testing.assert_allclose(
        again((physical - other.mean[1:]) / np.array(other.sd[1:])), one((physical - one.mean) / one.sd), rtol=1e-9
    )


def test_joined_scales_and_tables_are_weighted_means() -> None:
    scales, weights = [scale(8, 0.5, seed=k) for k in (1, 2)], np.array([0.3, 0.7])
    scaling = Scaling((0.0, 90.0, 1.0), (1.0, 50.0, 0.5))
    scales = [replace(blending.rescaled(one, scaling), sigma_max=np.array([1e6])) for one in scales]
    condition = np.random.default_rng(3).normal(0, 1, (50, 2))
    expected = np.exp(sum(w * np.log(one(condition)) for w, one in zip(weights, scales, strict=True)))
    np.testing.assert_allclose(blending.joined_scales(scales, weights)(condition), expected, rtol=1e-9)
    rng = np.random.default_rng(4)
    tables = [
        SpeedForceTable(np.array([10.0, 80.0, 200.0]), np.array([-1.0, 0.5]), rng.uniform(-1, 1, (6, 4))),
        SpeedForceTable(np.array([30.0, 150.0]), np.array([0.0]), rng.uniform(-1, 1, (2, 6))),
    ]
    speed, force = rng.uniform(0, 250, 100), rng.uniform(0.05, 3.0, 100)
    expected = 0.3 * np.pad(tables[0].at(speed, force), ((0, 0), (0, 2))) + 0.7 * tables[1].at(speed, force)
    # Float32 knots.
    np.testing.assert_allclose(blending.joined_tables(tables, weights).at(speed, force), expected, atol=1e-6)


def test_tones_begin_in_step() -> None:
    """The same tones begun elsewhere on the path are the same again."""
    rng, phase = np.random.default_rng(5), 1.3
    table = SpeedForceTable(np.zeros(1), np.zeros(1), rng.normal(0, 1, (1, 6)))
    pairs = table.values.reshape(1, 3, 2)
    turned = (pairs[..., 0] - 1j * pairs[..., 1]) * np.exp(1j * phase * np.arange(1, 4))
    moved = replace(table, values=np.stack([turned.real, -turned.imag], axis=2).reshape(1, 6))
    np.testing.assert_allclose(blending.in_step(moved, table).values, table.values, atol=0.03)  # steps of half a degree


def test_a_texture_and_itself_begun_elsewhere_on_the_path_blend_into_it(textures: dict[str, Texture]) -> None:
    """Half a period on its odd multiples are negative, and cancelled."""
    texture, values = textures[WITH_TONES], textures[WITH_TONES].tensors["tones.values"]
    sign = np.repeat((-1.0) ** np.arange(1, values.shape[1] // 2 + 1), 2).astype(np.float32)
    moved = replace(texture, tensors={**texture.tensors, "tones.values": sign * values})
    blended = blending._blended(texture, moved, 0.5).tensors["tones.values"]
    np.testing.assert_allclose(blended, values, atol=1e-6 * np.abs(values).max())  # float32


@pytest.mark.parametrize("at", [0.3, 0.7])
def test_a_blend_with_what_a_microphone_heard_says_so(textures: dict[str, Texture], at: float) -> None:
    """Also where the other texture is nearer."""
    plain, other = textures[WITHOUT_TONES], textures[WITH_TONES]
    heard = replace(other, card={**other.card, "microphone": True})
    assert blending._blended(plain, heard, at).card["microphone"] is True
    assert "microphone" not in blending._blended(plain, other, at).card


@pytest.mark.parametrize(("first", "second"), [(WITHOUT_TONES, WITH_TONES)])
def test_a_blend_lies_between(
    textures: dict[str, Texture], descriptions: dict[str, Description], first: str, second: str
) -> None:
    check_between(textures, descriptions, first, second, (0.4,))


@pytest.mark.slow
@pytest.mark.parametrize(("first", "second"), list(itertools.combinations(PLUS, 2)))
def test_every_blend_lies_between(
    textures: dict[str, Texture], descriptions: dict[str, Description], first: str, second: str
) -> None:
    check_between(textures, descriptions, first, second, tuple(np.linspace(0.1, 0.9, 9)))


def check_between(
    textures: dict[str, Texture],
    descriptions: dict[str, Description],
    first: str,
    second: str,
    points: tuple[float, ...],
) -> None:
    """Level, centroid and width rise or fall all the way; reflections are below 1; `Renderer` replays the proof."""
    blends = [blending.blend(textures[first], textures[second], float(at)) for at in points]
    steps = [descriptions[first], *map(describe, blends), descriptions[second]]
    figures = np.array([[one.level_db, np.log2(one.centroid_hz), one.width_octaves] for one in steps])
    back = -np.sign(figures[-1] - figures[0]) * np.diff(figures, axis=0)
    assert (back.max(axis=0) < [0.01, 0.025, 0.025]).all(), back  # octaves: twice what the search leaves
    for texture in blends:
        for name, tensor in texture.tensors.items():
            assert not name.endswith("reflections") or np.abs(tensor).max() < 1
        Renderer(texture).render(np.linspace(0, 600, 2000), np.full(2000, 1.0))
        assert "not measured" in texture.evidence


def test_the_ends_of_a_blend_are_the_textures(textures: dict[str, Texture]) -> None:
    sides = textures[WITHOUT_TONES], textures[WITH_TONES]
    assert blending.blend(*sides, 0.0) is sides[0]
    assert blending.blend(*sides, 1.0) is sides[1]


def test_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    towel, jeans, out = (str(path) for path in (FOLDER / "towel.foten", FOLDER / "jeans.foten", tmp_path / "a.foten"))
    assert _status(["describe", towel, "--json"]) == 0
    before = json.loads(capsys.readouterr().out)
    assert _status(["edit", towel, "--level", "+3", "--brighter", "0.5", "-o", out]) == 0
    assert "wrote" in capsys.readouterr().out
    assert _status(["describe", out, "--json"]) == 0
    after = json.loads(capsys.readouterr().out)
    assert after["level_db"] - before["level_db"] == pytest.approx(3, abs=0.01)
    assert _status(["info", out]) == 0
    assert "edited: level +3 dB, centroid +0.5 octaves, not measured" in capsys.readouterr().out
    assert _status(["edit", out, "--level", "1", "-o", out]) == 0
    assert "centroid +0.5 octaves, not measured; edited: level +1 dB" in read_texture(out).evidence
    assert _status(["blend", towel, jeans, "--at", "0.3", "-o", out]) == 0
    assert read_texture(out).evidence == "blended: 0.7 towel, 0.3 jeans, not measured"
    for name in ("t.h", "t.ahap", "t.wav", "t.haptic"):
        constants = ["--speed", "80", "--force", "1", "--seconds", "0.3"] * (name != "t.h")
        assert _status(["export", out, *constants, "-o", str(tmp_path / name)]) == 0
        assert "blended: 0.7 towel, 0.3 jeans" in (tmp_path / name).read_bytes().decode("latin-1"), name


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["edit", "towel", "--period", "1"], "the texture has no period to change"),
        (["edit", "jeans", "--period", "100"], "the period is 100 mm, expected 0.09 to 9 mm"),
        (["edit", "towel"], "nothing to change, expected --level"),
        (["edit", "towel", "--brighter", "9"], "brighter is 9 octaves, expected -3 to 3"),
        (["edit", "towel", "--wider", "-2"], "wider is -2 octaves, the width is"),
        (["edit", "steel-mesh-1_ar", "--brighter", "1"], "only the level of ar can be edited"),
        (["blend", "towel", "jeans", "--at", "2"], "at is 2, expected 0"),
        (["blend", "towel", "steel-mesh-1_ar"], "a texture is of ar, expected two of foten-plus"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    named = [str(FOLDER / f"{word}.foten") if (FOLDER / f"{word}.foten").exists() else word for word in arguments]
    assert _status([*named, "-o", str(tmp_path / "out.foten")]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_noise_keeps_its_envelope() -> None:
    texture = exported("foten-plus", TRAINABLE["foten-plus"].sizes(**SMALL_PLUS, order=2))
    assert with_envelope(texture, 0.7) is texture


@pytest.mark.parametrize("rougher_db", [-0.1, 0.5, 1.5])
def test_an_edit_makes_a_texture_as_rough_as_asked(rougher_db: float) -> None:
    result = edited(read_texture(FOLDER / "towel.foten"), Edit(rougher=rougher_db))
    before, after = result.before, result.after
    assert after.roughness_db - before.roughness_db == pytest.approx(rougher_db, abs=0.15)
    assert after.level_db == pytest.approx(before.level_db, abs=0.01)
    assert np.log2(after.centroid_hz / before.centroid_hz) == pytest.approx(0, abs=0.05)
    assert after.width_octaves == pytest.approx(before.width_octaves, abs=0.05)
    assert not result.unreached
    assert f"roughness {rougher_db:+g} dB" in result.texture.evidence


def test_noise_has_an_envelope_of_its_own_and_that_is_said() -> None:
    result = edited(read_texture(FOLDER / "towel.foten"), Edit(rougher=-2.0))
    assert -0.5 < result.after.roughness_db - result.before.roughness_db < 0
    assert result.unreached[-1].startswith("the roughness is ")


def test_roughness_rises_with_the_strength() -> None:
    texture = read_texture(FOLDER / "towel.foten")
    curve = EnvelopeCurve(texture)
    assert (np.diff(curve.roughness_db) >= 0).all()
    assert curve.roughness_db[STRENGTHS.index(0.0)] == steady_figures(texture).roughness_db
    assert curve.strength(0.0) == 0.0
    assert curve.strength(99.0) == 2.0
    assert with_envelope(texture, 0.0) is texture
