"""A picture of heights as a recording: a profile along the stroke, under the tip of `simulation.contact_mechanics`.

    picture ─▶ heights [mm] ─▶ profile along the stroke ─▶ contact mechanics under a moving hand ─▶ Recording

A normal map, as of a game's material, is integrated first. A picture that tiles goes on at its edge; another is mirrored there.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.recording.recording import Recording
from foten.simulation.contact_mechanics import (
    CONTACT,
    GRID_MM,
    LOOP_MM,
    RATE_HZ,
    ContactParameters,
    contact_vibration,
    under_ball,
)
from foten.simulation.simulate import sensor_channels
from foten.simulation.stroking import Stroking, stroking
from foten.untrusted import check_content

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".exr")
MAX_PIXELS = 17_000_000
MAX_WIDTH_MM = 10 * LOOP_MM
MIN_SIDE = 8  # pixels
MIN_SCALE_MM, MAX_SCALE_MM = 1e-3, 5.0  # of a pixel
MAX_DEPTH_MM = 10.0
NORMAL_LENGTH = 0.08  # standard deviation of the length of a pixel's normal, of a normal map at most
NORMAL_SHARE = 0.9  # of pixels whose normal points out of the surface
MIN_PERIOD_PROMINENCE_DB = 14.0  # of a photo's spectral peak, that proposes a period (measured on 21 photos)


def picture_contents(path: Path) -> tuple[None, list[Array]]:
    """Values of a picture, for `datasets.isolated`: its libraries may crash, or write to the terminal."""
    return None, [read_picture(path)]


def read_picture(path: Path) -> Array:
    """Values (rows, columns) of grey, or (rows, columns, 3), integers as 0 to 1; ValueError for no picture, or its size."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"{path.name} is no picture, expected one of {' '.join(SUFFIXES)}")
    pixels = _read_exr(path) if suffix == ".exr" else _read_image(path)
    if pixels.ndim == 3:
        pixels = pixels[..., :3] if pixels.shape[2] >= 3 else pixels[..., 0]
    if min(pixels.shape[:2]) < MIN_SIDE or pixels.shape[0] * pixels.shape[1] > MAX_PIXELS:
        size = f"{pixels.shape[1]} × {pixels.shape[0]} pixels"
        raise ValueError(f"{path.name} has {size}, expected {MIN_SIDE} × {MIN_SIDE} to {MAX_PIXELS / 1e6:g} million")
    if not np.isfinite(pixels).all():
        raise ValueError(f"{path.name} holds NaN or infinity")
    return pixels


def _read_image(path: Path) -> Array:
    import warnings

    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # of pictures that `MAX_PIXELS` allows
            opened = Image.open(path)
        with opened:
            image: Image.Image = opened
            if image.width * image.height > MAX_PIXELS:
                size = f"{image.width} × {image.height} pixels"
                raise ValueError(f"{path.name} has {size}, expected {MAX_PIXELS / 1e6:g} million: make it smaller")
            check_content(path, 2 * image.width * image.height * len(image.getbands()))  # a value has 16 bits at most
            if image.mode in ("P", "LA", "RGBA", "CMYK", "1"):
                image = image.convert("RGB")
            pixels: NDArray[Any] = np.asarray(image)
    except Image.DecompressionBombError:
        raise ValueError(f"{path.name} has too many pixels, expected {MAX_PIXELS / 1e6:g} million at most") from None
    except (UnidentifiedImageError, OSError, SyntaxError) as error:
        raise ValueError(f"{path.name} is truncated or is no picture ({error})") from None
    # Pillow opens some of 16 bits as 32.
    largest = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 65535 if pixels.dtype.kind == "i" else 1
    return np.divide(pixels, largest, dtype=np.float64)


def _read_exr(path: Path) -> Array:
    try:
        import OpenEXR

        channels = OpenEXR.File(str(path), separate_channels=True).channels()
    except ModuleNotFoundError:
        raise ValueError(f"{path.name} needs the package OpenEXR: pip install OpenEXR") from None
    except Exception as error:  # whatever the library raises on a damaged file
        raise ValueError(f"{path.name} is truncated or is no EXR picture ({error})") from None
    names = [name for name in ("R", "G", "B") if name in channels] or sorted(channels)[:1]
    return np.squeeze(np.stack([channels[name].pixels.astype(np.float64) for name in names], axis=-1))


def grey_of(pixels: Array) -> Array:
    """Luminance (rows, columns) of a picture; Rec. 601."""
    return pixels if pixels.ndim == 2 else pixels @ np.array([0.299, 0.587, 0.114])


def is_normal_map(pixels: Array) -> bool:
    """Whether the colours of a picture are unit vectors that point out of a surface."""
    if pixels.ndim != 3:
        return False
    normals = 2 * pixels[:: 1 + len(pixels) // 1000] - 1
    length = np.sqrt(np.square(normals).sum(axis=2))
    return bool(
        abs(length.mean() - 1) < 0.1 and length.std() < NORMAL_LENGTH and (normals[..., 2] > 0).mean() > NORMAL_SHARE
    )


def heights_of(pixels: Array, scale_mm: float, depth_mm: float) -> Array:
    """Heights [mm], (rows, columns): the darkest pixel to the lightest is `depth_mm`; of a normal map, where that is given."""
    heights = integrated(2 * pixels - 1, scale_mm) if is_normal_map(pixels) else grey_of(pixels)
    span = float(np.ptp(heights))
    if not span > 0:
        raise ValueError("the picture is of one height: there is nothing to feel")
    return (heights - heights.mean()) * (depth_mm / span)


def integrated(normals: Array, scale_mm: float) -> Array:
    """Heights [mm] of normals (rows, columns, 3), green up, of a picture that tiles.

    Source: Frankot and Chellappa, "A method for enforcing integrability in shape from shading algorithms" (1988).
    """
    z = np.maximum(normals[..., 2], 0.05)
    slope_x, slope_y = -normals[..., 0] / z, normals[..., 1] / z  # rows go down, and green points up
    rows, columns = z.shape
    v, u = (2 * np.pi * np.fft.fftfreq(n, scale_mm) for n in (rows, columns))
    over = np.square(u)[None, :] + np.square(v)[:, None]
    over[0, 0] = 1.0
    spectrum = (-1j * u[None, :] * np.fft.fft2(slope_x) - 1j * v[:, None] * np.fft.fft2(slope_y)) / over
    spectrum[0, 0] = 0.0
    return np.asarray(np.fft.ifft2(spectrum).real)


def profile_along(heights: Array, scale_mm: float, tiles: bool, length_mm: float = LOOP_MM) -> Array:
    """Closed profile [mm], a point every `GRID_MM`, along a slanted line over the tiled plane of heights (rows, columns)."""
    from scipy.ndimage import map_coordinates

    if (width_mm := heights.shape[1] * scale_mm) > MAX_WIDTH_MM:
        raise ValueError(f"the picture is {width_mm:g} mm wide, expected {MAX_WIDTH_MM:g} at most; is --scale in mm?")
    rows, columns = (n if tiles else 2 * n for n in heights.shape)
    n_turns = max(1, round(length_mm / (columns * scale_mm)))
    n = round(n_turns * (columns * scale_mm) / GRID_MM)
    share = np.arange(n) / n
    x, y = share * n_turns * columns, share * rows  # down the picture once
    lines = map_coordinates(
        heights, np.stack([y % rows, x % columns]), order=3, mode="grid-wrap" if tiles else "reflect"
    )
    return np.asarray(lines - lines.mean())


def imagined(
    heights: Array,
    scale_mm: float,
    tool: ContactParameters,
    tiles: bool = True,
    seconds: float = 64.0,
    seed: int = 0,
    stroke: Stroking | None = None,
) -> Recording:
    """What sensors would record of a hand on heights [mm] (rows, columns), by contact mechanics.

    Args:
        scale_mm: of a pixel.
        tool: its tip and the contact; what it says of a profile is not used.
        seed: of the hand and the sensors.
        stroke: at `RATE_HZ`; by default one over all speeds and forces.
    """
    surface = under_ball(profile_along(heights, scale_mm, tiles), tool.tip_mm)
    stroke = stroke or stroking(seconds, seed, RATE_HZ)
    rng = np.random.default_rng([seed, 5])
    acceleration, force = contact_vibration(tool, surface, stroke, rng)
    channels = sensor_channels(acceleration, force, tool.friction, stroke, 1, rng)
    held = f"simulated tip of {tool.tip_mm:g} mm and {tool.tip_mass_g:g} g, contact of {tool.modulus_mpa:g} MPa"
    return Recording(channels, tool=held, sensors="simulated", notes="from a height map, not measured")


def tool_of(tip_mm: float = 0.8, mass_g: float = 14.0, modulus_mpa: float = 200.0) -> ContactParameters:
    """The contact of a tool: radius of its tip, its mass as the surface feels it, E*; held as on `canvas`."""
    return replace(CONTACT["canvas"], tip_mm=tip_mm, tip_mass_g=mass_g, modulus_mpa=modulus_mpa)


def proposed_period(pixels: Array, scale_mm: float) -> float | None:
    """The period [mm] along the stroke that a photo shows, or None where no peak stands out by 14 dB."""
    grey = grey_of(pixels)
    rows = grey - grey.mean(axis=1, keepdims=True)
    power = (np.abs(np.fft.rfft(rows * np.hanning(rows.shape[1]), axis=1)) ** 2).mean(axis=0)
    per_mm = np.fft.rfftfreq(rows.shape[1], scale_mm)
    inside = np.arange(3, len(power) - 1)  # three periods in the picture, or more
    if inside.size < 8:
        return None
    peak = inside[np.argmax(power[inside])]
    around = inside[(inside > peak / 2) & (inside < 2 * peak) & (np.abs(inside - peak) > 2)]
    if not around.size or 10 * np.log10(power[peak] / np.median(power[around])) < MIN_PERIOD_PROMINENCE_DB:
        return None
    return float(1 / per_mm[peak])
