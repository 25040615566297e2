"""Height maps: periods are where the path has them, a normal map is its heights, a profile gives its own texture back."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from foten.cli.command_line import _status
from foten.dsp.distance import log_spectral_distance, scored_bins, welch
from foten.editing.height_map import (
    heights_of,
    imagined,
    integrated,
    is_normal_map,
    profile_along,
    proposed_period,
    read_picture,
    tool_of,
)
from foten.models.texture_file import read_texture
from foten.recording.recording import Channel
from foten.simulation.contact_mechanics import CONTACT, GRID_MM, RATE_HZ, contact_vibration, profile, surface_of
from foten.simulation.simulate import sensor_channels
from foten.simulation.stroking import Stroking

SCALE = 0.05  # mm a pixel


def steady(speed: float, force: float, seconds: float) -> Stroking:
    n = round(seconds * RATE_HZ)
    velocity = np.stack([np.full(n, speed), np.zeros(n)], axis=1)
    position = np.cumsum(velocity, axis=0) / RATE_HZ
    return Stroking(RATE_HZ, position, velocity, np.full(n, force), np.zeros((n, 2)))


def waves(period_mm: float, rows: int = 64, weave: bool = False) -> np.ndarray:
    """Twenty periods of a sine along the rows; of a weave, every second one shifted from thread to thread."""
    columns = round(20 * period_mm / SCALE)
    x, y = np.arange(columns) / columns * 20, np.arange(rows) / rows * 4
    if weave:
        return 0.5 + 0.25 * (np.cos(2 * np.pi * x)[None] + 0.5 * np.cos(np.pi * x)[None] * np.cos(np.pi * y)[:, None])
    return np.tile(0.5 + 0.5 * np.cos(2 * np.pi * x), (rows, 1))


@pytest.mark.parametrize(
    "speed", [40.0, *(pytest.param(v, marks=pytest.mark.slow) for v in (70.0, 100.0, 150.0)), 220.0]
)
@pytest.mark.parametrize(("period_mm", "weave"), [(0.65, False), (1.3, False), (2.6, False), (1.3, True)])
def test_a_period_vibrates_at_the_speed_over_it(period_mm: float, speed: float, weave: bool) -> None:
    """The centre of power around v/λ, to 2 %."""
    heights = heights_of(waves(period_mm, weave=weave), SCALE, 0.02)
    z = imagined(heights, SCALE, tool_of(), stroke=steady(speed, 0.8, 4.0))["acceleration_z"].samples[5000:]
    hz, power = welch(z, RATE_HZ, 20_000)
    expected = speed / period_mm
    near = np.abs(hz - expected) < 0.15 * expected
    assert np.average(hz[near], weights=power[near]) == pytest.approx(expected, rel=0.02)
    beside = (np.abs(hz - expected) < 0.45 * expected) & (np.abs(hz - expected) > 0.2 * expected)
    assert power[near].max() > 30 * np.median(power[beside])


def recorded(key: str, stroke: Stroking, seed: int) -> dict[str, Channel]:
    """What sensors record of a simulated texture."""
    p, rng = CONTACT[key], np.random.default_rng(seed)
    acceleration, force = contact_vibration(p, surface_of(p, key), stroke, rng)
    return sensor_channels(acceleration, force, p.friction, stroke, 1, rng)


SLOWLY = [pytest.param(key, marks=pytest.mark.slow) for key in ("sawn-wood", "sandpaper-coarse", "canvas")]


@pytest.mark.parametrize("key", SLOWLY)
def test_the_map_of_a_profile_gives_its_texture_back(key: str) -> None:
    """Spectra within 1.5 times the distance of a second realisation, at three conditions."""
    p = CONTACT[key]
    coarse = profile(p, key)[:: round(0.02 / GRID_MM)]
    heights = np.tile(coarse, (8, 1))
    ours, ceiling = [], []
    for speed, force in ((60.0, 0.5), (100.0, 1.0), (180.0, 1.5)):
        stroke = steady(speed, force, 8.0)
        signals = [recorded(key, stroke, seed) for seed in (1, 2)]
        signals.append(dict(imagined(heights, 0.02, p, stroke=stroke).channels))
        densities = []
        for channels in signals:
            axes = np.stack([channels[f"acceleration_{axis}"].samples[5000:] for axis in "xyz"])
            hz, power = welch(axes, RATE_HZ, 2560)
            densities.append(power.sum(axis=0)[scored_bins(hz, RATE_HZ)])
        ceiling.append(log_spectral_distance(densities[0], densities[1]))
        ours.append(log_spectral_distance(densities[0], densities[2]))
    assert np.mean(ours) < 1.5 * np.mean(ceiling)


def test_a_normal_map_is_its_heights() -> None:
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:96, 0:128]
    heights = sum(
        rng.normal() * np.cos(2 * np.pi * (i * x / 128 + j * y / 96) + rng.uniform(0, 6))
        for i in range(5)
        for j in range(4)
    )
    heights *= 0.02 / np.ptp(heights)
    slope_y, slope_x = (np.gradient(np.pad(heights, 1, mode="wrap"), SCALE, axis=axis)[1:-1, 1:-1] for axis in (0, 1))
    normals = np.stack([-slope_x, slope_y, np.ones_like(heights)], axis=2)  # green points up, rows go down
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    pixels = np.round((normals + 1) / 2 * 255) / 255
    assert is_normal_map(pixels)
    assert not is_normal_map(np.repeat(heights[..., None], 3, axis=2))
    assert np.corrcoef(integrated(2 * pixels - 1, SCALE).ravel(), heights.ravel())[0, 1] > 0.9975  # of 8 bits
    assert np.ptp(heights_of(pixels, SCALE, 0.3)) == pytest.approx(0.3)


@pytest.mark.parametrize("tiles", [True, False])
def test_no_edge_of_a_picture_is_felt(tiles: bool) -> None:
    """A ramp that does not tile has a cliff at its edge, which is mirrored away."""
    ramp = np.tile(np.linspace(0, 1, 200), (40, 1))
    steps = np.abs(np.diff(np.append(line := profile_along(ramp, SCALE, tiles, 100.0), line[0])))
    assert (steps.max() > 0.1) == tiles
    twice = np.concatenate([ramp := ramp[:, :80] ** 3, ramp[:, ::-1]], axis=1)
    mirrored = profile_along(np.concatenate([twice, twice[::-1]]), SCALE, True, 100.0)
    np.testing.assert_allclose(profile_along(ramp, SCALE, False, 100.0), mirrored, atol=1e-12)
    with pytest.raises(ValueError, match="the picture is 40001 mm wide, expected 40000 at most"):
        profile_along(twice, 40001 / twice.shape[1], True)


def test_pictures_of_many_kinds_are_read(tmp_path: Path) -> None:
    grey = waves(1.3)
    Image.fromarray(np.round(grey * 255).astype(np.uint8)).save(tmp_path / "8.png")
    Image.fromarray(np.round(grey * 65535).astype(np.uint16)).save(tmp_path / "16.png")
    Image.fromarray(grey.astype(np.float32)).save(tmp_path / "float.tiff")
    Image.fromarray(np.repeat(np.round(grey * 255).astype(np.uint8)[..., None], 4, axis=2)).save(tmp_path / "rgba.png")
    for name, tolerance in (("8.png", 2e-3), ("16.png", 1e-5), ("float.tiff", 1e-6), ("rgba.png", 2e-3)):
        pixels = read_picture(tmp_path / name)
        np.testing.assert_allclose(pixels if pixels.ndim == 2 else pixels[..., 0], grey, atol=tolerance)


@pytest.mark.filterwarnings("error")
def test_a_picture_that_pillow_thinks_too_large_is_refused_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Image.new("L", (64, 64)).save(tmp_path / "map.png")
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 64 * 64 - 1)
    assert read_picture(tmp_path / "map.png").shape == (64, 64)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 64 * 64 // 2 - 1)
    with pytest.raises(ValueError, match=r"map.png has too many pixels, expected 17 million at most"):
        read_picture(tmp_path / "map.png")


def test_an_exr_is_read(tmp_path: Path) -> None:
    exr = pytest.importorskip("OpenEXR")
    grey = waves(1.3).astype(np.float32)
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    exr.File(header, {"Y": grey}).write(str(tmp_path / "h.exr"))
    np.testing.assert_allclose(read_picture(tmp_path / "h.exr"), grey)


def test_a_photo_proposes_a_period_or_none() -> None:
    rng = np.random.default_rng(1)
    stripes = waves(1.3) + rng.normal(0, 0.3, waves(1.3).shape)
    assert proposed_period(stripes, SCALE) == pytest.approx(1.3, rel=0.03)
    assert proposed_period(rng.normal(0, 1, (64, 512)), SCALE) is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["flat.png", "--scale", "0.05"], "the picture is of one height: there is nothing to feel"),
        (["flat.png", "--scale", "20"], "--scale is 20 mm per pixel, expected 0.001 to 5; was it given in pixels"),
        (["flat.png", "--scale", "0.05", "--depth", "0"], "--depth is 0 mm, expected more than 0 and 10 at most"),
        (["tiny.png", "--scale", "0.05"], "tiny.png has 4 × 4 pixels, expected 8 × 8 to 17 million"),
        (["wide.png", "--scale", "0.05"], "wide.png has 1700001 × 10 pixels, expected 17 million"),
        (["bad.png", "--scale", "0.05"], "bad.png is truncated or is no picture"),
        (["bad.obj", "--scale", "0.05"], "bad.obj is no picture, expected one of .png"),
        (["none.png", "--scale", "0.05"], "none.png"),
        (["flat.png", "--scale", "0.05", "--photo"], "--output is for making a texture, and --photo only proposes"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    Image.fromarray(np.full((32, 32), 77, dtype=np.uint8)).save(tmp_path / "flat.png")
    Image.fromarray(np.zeros((4, 4), dtype=np.uint8)).save(tmp_path / "tiny.png")
    Image.fromarray(np.zeros((10, 1_700_001), dtype=np.uint8)).save(tmp_path / "wide.png")
    for name in ("bad.png", "bad.obj"):
        (tmp_path / name).write_bytes(b"x" * 300)
    before = sorted(tmp_path.iterdir())
    assert _status(["imagine", str(tmp_path / arguments[0]), *arguments[1:], "-o", str(tmp_path / "t.foten")]) == 2
    assert message in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before


def test_the_command_proposes_a_period(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Image.fromarray(np.round(waves(1.3) * 255).astype(np.uint8)).save(tmp_path / "cloth.png")
    assert _status(["imagine", str(tmp_path / "cloth.png"), "--photo", "--scale", "0.05"]) == 0
    assert "period 1.3 mm, a guess from light and shade" in capsys.readouterr().out


@pytest.mark.slow
def test_the_command_makes_a_texture_with_the_period_of_its_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Image.fromarray(np.round(waves(1.3) * 255).astype(np.uint8)).save(tmp_path / "cloth.png")
    path = str(tmp_path / "t.foten")
    assert _status(["imagine", str(tmp_path / "cloth.png"), "--scale", "0.05", "--depth", "0.03", "-o", path]) == 0
    out = capsys.readouterr().out
    assert "period     1.3 mm" in out
    assert read_texture(path).evidence.startswith("height map cloth.png, 0.05 mm a pixel, 0.03 mm deep, simulated tip")
