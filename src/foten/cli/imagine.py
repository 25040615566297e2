"""`foten imagine`: a texture from a height map."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

from foten.cli.editing import check_texture
from foten.console import JsonOption, print_result, refuse, say


def imagine(
    picture: Path = Argument(..., metavar="HEIGHT.png", help="Height, displacement or normal map: PNG, TIFF, EXR, …"),
    output: Path | None = Option(None, "-o", "--output", help="The texture to write, .foten."),
    scale: float = Option(..., metavar="MM", help="Of a pixel (mm)."),
    depth: float = Option(0.1, metavar="MM", help="From the darkest pixel to the lightest (mm)."),
    tiles: bool = Option(
        True, "--tiles/--no-tiles", help="Whether the picture goes on at its edges, or is mirrored there."
    ),
    tip: float | None = Option(None, metavar="MM", help="Radius of the tool's tip (mm).", show_default="0.8"),
    mass: float | None = Option(None, metavar="G", help="Of the tool, as the surface feels it (g).", show_default="14"),
    modulus: float | None = Option(
        None,
        metavar="MPA",
        help="Of the contact, E* (MPa): skin 0.1, rubber 10, wood 300, steel 2000.",
        show_default="200",
    ),
    seconds: float = Option(64.0, min=14.0, help="That are stroked in the simulation (s)."),
    seed: int = Option(0, min=0, max=2**32 - 1, help="Of the hand, the sensors and the training."),
    photo: bool = Option(False, "--photo", help="It shows light and not height: only propose a period."),
    as_json: JsonOption = False,
) -> None:
    """Make a texture from a picture of heights: stroked by a simulated tool, and learned from that.

    foten imagine bricks_height.png --scale 0.05 --depth 0.3 -o bricks.foten

    foten imagine cloth.jpg --photo --scale 0.06: the period that a photo shows; nothing more can be taken from one.
    """
    from foten.editing import height_map

    if not height_map.MIN_SCALE_MM <= scale <= height_map.MAX_SCALE_MM:
        expected = f"expected {height_map.MIN_SCALE_MM:g} to {height_map.MAX_SCALE_MM:g}"
        raise ValueError(f"--scale is {scale:g} mm a pixel, {expected}; was it given in pixels a mm?")
    if photo:
        refuse("is of a texture, and --photo proposes a period", output=output, tip=tip, mass=mass, modulus=modulus)
        _propose(picture, scale, as_json)
        return
    if output is None:
        raise ValueError("expected -o FILE, the texture to write")
    check_texture(output)
    if not 0 < depth <= height_map.MAX_DEPTH_MM:
        raise ValueError(f"--depth is {depth:g} mm, expected more than 0 and {height_map.MAX_DEPTH_MM:g} at most")
    _imagine(
        picture,
        output,
        scale,
        depth,
        tiles,
        {"tip_mm": tip, "mass_g": mass, "modulus_mpa": modulus},
        seconds,
        seed,
        as_json,
    )


def _propose(picture: Path, scale: float, as_json: bool) -> None:
    from foten.editing.height_map import MIN_PERIOD_PROMINENCE_DB, proposed_period, read_picture

    period = proposed_period(read_picture(picture), scale)
    if period is None:
        text = f"no period: no peak of the picture's spectrum stands out by {MIN_PERIOD_PROMINENCE_DB:g} dB"
    else:
        text = f"period {period:.3g} mm, a guess from light and shade; next: foten edit T.foten --period {period:.3g}"
    print_result({"period_mm": period}, text, as_json)


def _imagine(
    picture: Path,
    output: Path,
    scale: float,
    depth: float,
    tiles: bool,
    tool: dict[str, float | None],
    seconds: float,
    seed: int,
    as_json: bool,
) -> None:
    from dataclasses import replace

    from foten.baselines.sizes import trainable_sizes
    from foten.editing.describe import describe
    from foten.editing.edit import UNMEASURED
    from foten.editing.height_map import heights_of, imagined, read_picture, tool_of
    from foten.models.texture_file import Texture, write_texture
    from foten.training.config import recipe_of
    from foten.training.job import TrainingJob
    from foten.training.loop import Monitor
    from foten.training.pipeline import train

    heights = heights_of(read_picture(picture), scale, depth)
    say(
        f"stroking {picture.name}, {heights.shape[1] * scale:.3g} × {heights.shape[0] * scale:.3g} mm, for {seconds:g} s …"
    )
    contact = tool_of(**{name: value for name, value in tool.items() if value is not None})
    recording = imagined(heights, scale, contact, tiles, seconds, seed)
    recording = replace(recording, texture=picture.stem)
    job = TrainingJob(
        recording, "foten-plus", trainable_sizes("foten-plus", {}), recipe_of("foten-plus", "default", seed=seed)
    )
    trained = train(job, Monitor(lambda stage: say(f"{stage} …"))).texture
    evidence = (
        f"from the height map {picture.name}, {scale:g} mm a pixel, {depth:g} mm deep, {recording.tool}, {UNMEASURED}"
    )
    texture = Texture({**trained.card, "evidence": evidence}, trained.tensors)
    write_texture(texture, output)
    description = describe(texture)
    lines = [f"{name:11s}{figure}" for name, figure in description.figures(texture.unit).items()]
    lines.append(f"wrote {output}; next: foten serve {output}")
    print_result({"output": str(output), **description.to_json()}, "\n".join(lines), as_json)
