"""`foten render`: vibration of a texture under a stroke, into files."""

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from typer import Option

from foten import __version__
from foten.cli.stroke_options import Deterministic, StrokeOptions, UserFile
from foten.console import TextureFile, check_files, options_from, print_result, refuse, say
from foten.dsp import Array
from foten.editing.tool import read_transfer, transferred
from foten.editing.user import UserProfile, adapted, read_user
from foten.models.conditions import EXTRAPOLATION_LIMIT, FADE_FORCE, FADE_SPEED, REACH_FORCE, REACH_SPEED
from foten.models.texture_file import Texture, read_texture
from foten.recording.recording import counted
from foten.runtime.live import sinks
from foten.runtime.renderer import Renderer

SAY_EVERY_S = 5.0  # how far a long rendering is


@dataclass(frozen=True, kw_only=True)
class RenderOptions(StrokeOptions):
    """Options of `foten render`."""

    texture_file: TextureFile
    output: list[Path] = Option(
        ..., "-o", "--output", help="File to write: .wav (float, m/s²), .csv, .npz or .png (plots); repeatable."
    )
    audible: Path | None = Option(
        None, metavar="FILE.wav", help="Also write the vibration as audible sound (48 kHz, 16 bits)."
    )
    tool: Path | None = Option(
        None, metavar="TOOL.json", help="Render for another tool: file (.json) from 'foten tool measure'."
    )
    user: UserFile = None
    deterministic: Deterministic = False

    def __post_init__(self) -> None:
        if self.deterministic:
            refuse("sets the excitation, and --deterministic has none", seed=self.seed or None)


@options_from(RenderOptions)
def render(options: RenderOptions) -> None:
    """Render the vibration of a texture under a stroke, into files."""
    output, audible = options.output, options.audible
    for path in output:
        sinks.check_suffix(path)
    written = [*output] if audible is None else [*output, audible]
    check_files(written)
    texture = read_texture(options.texture_file)
    if options.tool is not None:
        texture = transferred(texture, read_transfer(options.tool))
    texture = for_user(texture, options.user)
    rate, unit = texture.rate_hz, texture.unit
    if audible is not None:
        sinks.audible_factor(rate)
        if audible.suffix.lower() != ".wav":
            raise ValueError(f"sound is written as .wav, got --audible {audible.name}")
    if len({os.path.realpath(path) for path in written}) < len(written):
        raise ValueError("two outputs have the same name")
    speed, force, source = options.conditions(texture)
    metadata = {**provenance(texture, source, options.seed, options.deterministic), "rate_hz": rate}
    renderer = Renderer(texture, seed=options.seed, excitation=not options.deterministic)
    acceleration = rendered_by(renderer, speed, force)
    for path in output:
        sinks.write_rendered(path, acceleration, speed, force, rate, metadata)
    gain = sinks.write_audible(audible, acceleration, rate) if audible is not None else None
    rms, peak = float((acceleration**2).mean() ** 0.5), float(abs(acceleration).max())
    lines = [f"{acceleration.size / rate:g} s at {rate:g} Hz, {rms:.3g} {unit} rms, {peak:.3g} {unit} peak"]
    lines.append(f"wrote {', '.join(str(path) for path in output)}")
    if gain is not None:
        lines.append(f"wrote {audible}, where 1 {unit} is {gain:.3g} of full scale")
    levels = {"rms_m_s2": rms, "peak_m_s2": peak, "audible_gain": gain}
    document = {"outputs": [str(path) for path in output], **levels}
    print_rendered(document, lines, renderer.counted(), texture, options.as_json)
    if not texture.has_excitation and not options.deterministic:
        say(f"{texture.card['model']} has no excitation: its free run is deterministic and may fall silent")


def for_user(texture: Texture, user: Path | None, actuator: Path | None = None) -> Texture:
    """The texture as a user's profile has it; as it is without one."""
    if user is None:
        return texture

    return adapted(texture, user_with(user, actuator))


def user_with(user: Path, actuator: Path | None) -> UserProfile:
    """The profile in a file, or ValueError where it holds the response of an actuator that is compensated as well."""
    profile = read_user(user)
    if actuator is not None and profile.unit == "full scale":
        raise ValueError(
            f"{user} was measured without --actuator, so it holds the actuator's response: leave out --user or --actuator"
        )
    return profile


def provenance(texture: Texture, source: str, seed: int, deterministic: bool) -> dict[str, Any]:
    """Origin of a rendering, for the file that it is written to."""
    return {
        "foten": __version__,
        "texture": texture.card["texture"],
        "texture_sha256": texture.sha256(),
        **({"credit": texture.credit} if texture.credit else {}),
        **({"made": texture.evidence} if texture.evidence else {}),
        "stroke": source,
        "seed": seed,
        "deterministic": deterministic,
    }


def rendered_by(renderer: Renderer, speed: Array, force: Array) -> Array:
    """Acceleration [m/s²] under a stroke, second by second, so that Ctrl-C ends it, with progress where it takes long."""
    second = max(1, round(renderer.texture_rate))
    pieces, shown_s = [], time.monotonic()
    for start in range(0, speed.size, second):
        if time.monotonic() - shown_s >= SAY_EVERY_S:
            shown_s = time.monotonic()
            say(f"rendered {start / renderer.texture_rate:.0f} of {speed.size / renderer.texture_rate:.0f} s")
        pieces.append(renderer.render(speed[start : start + second], force[start : start + second]))
    return np.concatenate(pieces).astype(float)


def print_rendered(
    document: dict[str, Any], lines: list[str], counts: dict[str, int], texture: Texture, as_json: bool
) -> None:
    """Print a result, with how much of it lay outside of the recorded range, and say what the kernel found wrong."""
    print_result({**document, **counts}, "\n".join([*lines, *_outside_range(counts, texture)]), as_json)
    if n := counts["n_saturated"]:
        say(f"the saturator cut {counted(n, 'sample')}: the closed loop was unstable there")
    if n := counts["n_refused"]:
        say(f"speed or force was negative or not a number {counted(n, 'time')}: 0 or the value before was used")
    if n := counts["n_lost"]:
        say(f"silence in place of {counted(n, 'sample')} that were not finite; was the texture file written by foten?")


def _outside_range(counts: dict[str, int], texture: Texture) -> Iterator[str]:
    """How much of a rendering lay outside of the recorded range, and what was done there."""
    share = {name: f"{100 * count / counts['n']:.1f} %" for name, count in counts.items() if count}
    for name, unit, reach in (("speed", "mm/s", REACH_SPEED), ("force", "N", REACH_FORCE)):
        if of_time := share.get(f"n_{name}_beyond"):
            high, power = texture.trained_range(name)[1], texture.extrapolation_exponent(name)
            grown = f"the level grew as {name}^{power:.2g} there" if power else "the level was held there"
            yield f"{name} was above the trained {high:.4g} {unit} for {of_time} of the time; {grown}"
        if of_time := share.get(f"n_{name}_clamped"):
            limit = max(EXTRAPOLATION_LIMIT * texture.trained_range(name)[1], reach)
            yield f"{name} was above {limit:.4g} {unit} for {of_time} of the time, and was limited to that"
    if of_time := share.get("n_below"):
        slow = max(texture.trained_range("speed")[0], FADE_SPEED)
        light = max(texture.trained_range("force")[0], FADE_FORCE)
        below = f"speed was below {slow:.4g} mm/s or force below {light:.3g} N for {of_time} of the time"
        held = (texture.fades_below("speed"), texture.fades_below("force")) == (slow, light)
        fades = "the vibration fades there" if held else f"the level falls there, and fades {texture.fading_in_words()}"
        yield f"{below}; {fades}, to silence at rest"
