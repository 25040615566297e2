"""`foten imagine`: a texture from words, or from a height map."""

from __future__ import annotations

from pathlib import Path

from typer import Argument, Option

from foten.cli.editing import check_texture
from foten.console import JsonOption, print_result, refuse, say


def imagine(
    source: str = Argument(
        ...,
        metavar="WORDS|HEIGHT.png",
        help="Words in quotes, or a height, displacement or normal map (PNG, TIFF, EXR, …).",
    ),
    output: Path | None = Option(None, "-o", "--output", help="Texture file to write (.foten)."),
    library: Path | None = Option(
        None,
        metavar="DIR",
        help="Words only: library of at least 15 textures to learn from (see 'foten library').",
        show_default="none: the most similar of foten's own textures is adjusted",
    ),
    encoder: str | None = Option(
        None,
        help="Words only: sentence encoder, as a folder or a name; needs foten's extra 'words'.",
        show_default="built-in word vectors",
    ),
    rate: float | None = Option(None, help="Words only: sampling rate of the texture (Hz).", show_default="1000"),
    scale: float | None = Option(None, metavar="MM", help="Size of a pixel (mm); required for a picture."),
    depth: float | None = Option(
        None,
        metavar="MM",
        help="Height difference between the darkest and the lightest pixel (mm).",
        show_default="0.1",
    ),
    tiles: bool = Option(
        True,
        "--tiles/--no-tiles",
        help="Whether the picture repeats seamlessly (tiles); otherwise it is mirrored at its edges.",
    ),
    tip: float | None = Option(None, metavar="MM", help="Radius of the simulated tool's tip (mm).", show_default="0.8"),
    mass: float | None = Option(
        None, metavar="G", help="Mass of the simulated tool that acts on the surface (g).", show_default="14"
    ),
    modulus: float | None = Option(
        None, metavar="MPA", help="Contact modulus E* (MPa), e.g. rubber 10, wood 300, steel 2000.", show_default="200"
    ),
    seconds: float | None = Option(
        None, min=14.0, help="Duration of the simulated stroke over the picture (s).", show_default="64"
    ),
    seed: int = Option(
        0, min=0, max=2**32 - 1, help="Seed of the simulated stroke, the sensor noise and the training."
    ),
    photo: bool = Option(
        False, "--photo", help="The picture is a photograph, not a height map: only propose a period (mm)."
    ),
    as_json: JsonOption = False,
) -> None:
    """Make a texture from words, by regression over a library; or from a height map, stroked by a simulated tool.

    foten imagine "rough woven linen" --library surfaces -o linen.foten

    foten imagine bricks_height.png --scale 0.05 --depth 0.3 -o bricks.foten

    foten imagine cloth.jpg --photo --scale 0.06: the period that a photo shows; nothing more can be taken from one.
    """
    from foten.editing.height_map import SUFFIXES

    picture = Path(source)
    of_pictures = {"scale": scale, "depth": depth, "tip": tip, "mass": mass, "modulus": modulus, "seconds": seconds}
    if picture.suffix.lower() not in SUFFIXES and " " not in source and picture.suffix:
        raise ValueError(f"{picture.name} is no picture, expected one of {' '.join(SUFFIXES)}, or words in quotes")
    if picture.suffix.lower() in SUFFIXES:
        refuse("is for words, and a picture is given", library=library, encoder=encoder, rate=rate)
        if scale is None:
            raise ValueError("expected --scale, the size of a pixel in mm")
        _from_picture(picture, output, scale, depth, tiles, of_pictures, seed, photo, as_json)
        return
    refuse("is for pictures, and words are given", **of_pictures, photo=photo or None, tiles=None if tiles else False)
    _from_words(source, output, library, encoder, rate, as_json)


def _from_words(
    text: str, output: Path | None, folder: Path | None, encoder: str | None, rate_hz: float | None, as_json: bool
) -> None:
    from foten.editing import imagine as words
    from foten.editing.describe import describe
    from foten.editing.texture_library import Library, open_library
    from foten.editing.words import encoder_of
    from foten.models.texture_file import read_texture, write_texture
    from foten.runtime.renderer import EXAMPLE

    if output is None:
        raise ValueError("expected -o FILE, the texture to write")
    check_texture(output)
    own = [read_texture(path) for path in sorted(EXAMPLE.parent.glob("*.foten"))]
    library = open_library(folder) if folder else Library(EXAMPLE.parent, [])
    made = words.imagine(text, library, encoder_of(encoder), rate_hz, own)
    write_texture(made.texture, output)
    description = describe(made.texture)
    lines = [f"{name:11s}{figure}" for name, figure in description.figures(made.texture.unit).items()]
    if made.guessed:
        few = f"{len(library.entries)} textures are too few to learn from, expected {words.MIN_TEXTURES} or more"
        say(f"a guess: {few}; {made.nearest[0]} was adjusted instead")
    else:
        lines.append(
            f"spread     ± {made.spread_db:.1f} dB of the spectrum (1 sd); most similar by words: {', '.join(made.nearest)}"
        )
    lines.append(f"wrote {output}; next: foten edit {output} --level … --brighter … -o {output}")
    document = {"output": str(output), **description.to_json(), "spread_db": made.spread_db, "guessed": made.guessed}
    print_result({**document, "nearest": list(made.nearest)}, "\n".join(lines), as_json)


def _from_picture(
    picture: Path,
    output: Path | None,
    scale: float,
    depth_mm: float | None,
    tiles: bool,
    options: dict[str, float | None],
    seed: int,
    photo: bool,
    as_json: bool,
) -> None:
    from foten.editing import height_map

    if not height_map.MIN_SCALE_MM <= scale <= height_map.MAX_SCALE_MM:
        expected = f"expected {height_map.MIN_SCALE_MM:g} to {height_map.MAX_SCALE_MM:g}"
        raise ValueError(f"--scale is {scale:g} mm per pixel, {expected}; was it given in pixels per mm?")
    if photo:
        of_texture = {name: value for name, value in options.items() if name != "scale"}
        refuse("is for making a texture, and --photo only proposes a period", output=output, **of_texture)
        _propose(picture, scale, as_json)
        return
    if output is None:
        raise ValueError("expected -o FILE, the texture to write")
    check_texture(output)
    depth = 0.1 if depth_mm is None else depth_mm
    if not 0 < depth <= height_map.MAX_DEPTH_MM:
        raise ValueError(f"--depth is {depth:g} mm, expected more than 0 and {height_map.MAX_DEPTH_MM:g} at most")
    tool = {"tip_mm": options["tip"], "mass_g": options["mass"], "modulus_mpa": options["modulus"]}
    _imagine(picture, output, scale, depth, tiles, tool, options["seconds"] or 64.0, seed, as_json)


def _propose(picture: Path, scale: float, as_json: bool) -> None:
    from foten.datasets.isolated import read_isolated
    from foten.editing.height_map import MIN_PERIOD_PROMINENCE_DB, proposed_period

    period = proposed_period(read_isolated("picture", picture)[1][0], scale)
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

    from foten.datasets.isolated import read_isolated
    from foten.editing.describe import describe
    from foten.editing.edit import UNMEASURED
    from foten.editing.height_map import heights_of, imagined, tool_of
    from foten.models.foten_plus.config import FotenPlusConfig
    from foten.models.foten_plus.sizes import FotenPlusSizes
    from foten.models.texture_file import Texture, write_texture
    from foten.models.trainable import train
    from foten.training.job import TrainingJob
    from foten.training.loop import Monitor

    pixels = read_isolated("picture", picture)[1][0]
    try:
        heights = heights_of(pixels, scale, depth)
    except ValueError as error:
        raise ValueError(f"{picture.name}: {error}") from error
    say(f"stroking {picture.name}, {heights.shape[1] * scale:.3g} × {heights.shape[0] * scale:.3g} mm, {seconds:g} s …")
    contact = tool_of(**{name: value for name, value in tool.items() if value is not None})
    recording = imagined(heights, scale, contact, tiles, seconds, seed)
    recording = replace(recording, texture=picture.stem)
    job = TrainingJob(recording, "foten-plus", FotenPlusSizes(), FotenPlusConfig(seed=seed))
    trained = train(job, Monitor(lambda stage: say(f"{stage} …"))).texture
    evidence = f"height map {picture.name}, {scale:g} mm a pixel, {depth:g} mm deep, {recording.tool}, {UNMEASURED}"
    texture = Texture({**trained.card, "evidence": evidence}, trained.tensors)
    write_texture(texture, output)
    description = describe(texture)
    lines = [f"{name:11s}{figure}" for name, figure in description.figures(texture.unit).items()]
    lines.append(f"wrote {output}; next: foten serve {output}")
    print_result({"output": str(output), **description.to_json()}, "\n".join(lines), as_json)
