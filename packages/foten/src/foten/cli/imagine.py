"""`foten imagine`: a texture from words, or from a height map."""

from pathlib import Path

from typer import Argument, Option

from foten.cli.commands import load
from foten.cli.editing import write_described
from foten.console import JsonOption, check_output, print_result, refuse, say
from foten.editing.edit import UNMEASURED
from foten.models.texture_file import Texture


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
    from foten.editing.height_map import MAX_DEPTH_MM, MAX_SCALE_MM, MIN_SCALE_MM, SUFFIXES

    picture = Path(source)
    of_picture = {"depth": depth, "tip": tip, "mass": mass, "modulus": modulus, "seconds": seconds}
    if picture.suffix.lower() not in SUFFIXES:
        if " " not in source and picture.suffix:
            expected = f"expected one of {' '.join(SUFFIXES)}, or words in quotes"
            raise ValueError(f"{picture.name} is no picture, {expected}")
        of_words = {"scale": scale, **of_picture, "photo": photo, "tiles": not tiles}
        refuse("is for pictures, and words are given", **of_words)
        load("imagine words")(source, _needed(output), library, encoder, rate, as_json)
        return
    refuse("is for words, and a picture is given", library=library, encoder=encoder, rate=rate)
    if scale is None:
        raise ValueError("expected --scale, the size of a pixel in mm")
    if not MIN_SCALE_MM <= scale <= MAX_SCALE_MM:
        expected = f"expected {MIN_SCALE_MM:g} to {MAX_SCALE_MM:g}"
        raise ValueError(f"--scale is {scale:g} mm per pixel, {expected}; was it given in pixels per mm?")
    if photo:
        refuse("is for making a texture, and --photo only proposes a period", output=output, **of_picture)
        _propose(picture, scale, as_json)
        return
    given = {"tip_mm": tip, "mass_g": mass, "modulus_mpa": modulus}
    tool = {name: value for name, value in given.items() if value is not None}
    output, depth = _needed(output), 0.1 if depth is None else depth
    if not 0 < depth <= MAX_DEPTH_MM:
        raise ValueError(f"--depth is {depth:g} mm, expected more than 0 and {MAX_DEPTH_MM:g} at most")
    write_described(_texture_of(picture, scale, depth, tiles, tool, seconds or 64.0, seed), output, as_json)


def _needed(output: Path | None) -> Path:
    """The texture to write, checked."""
    if output is None:
        raise ValueError("expected -o FILE, the texture to write")
    check_output(output, "a texture", ".foten")
    return output


def _propose(picture: Path, scale: float, as_json: bool) -> None:
    from foten.datasets.isolated import read_isolated
    from foten.editing.height_map import MIN_PERIOD_PROMINENCE_DB, proposed_period

    period = proposed_period(read_isolated("picture", picture)[1][0], scale)
    if period is None:
        text = f"no period: no peak of the picture's spectrum stands out by {MIN_PERIOD_PROMINENCE_DB:g} dB"
    else:
        text = f"period {period:.3g} mm, a guess from light and shade; next: foten edit T.foten --period {period:.3g}"
    print_result({"period_mm": period}, text, as_json)


def _texture_of(
    picture: Path, scale: float, depth: float, tiles: bool, tool: dict[str, float], seconds: float, seed: int
) -> Texture:
    """The texture of a picture of heights: stroked by a simulated tool, and trained."""
    from dataclasses import replace

    from foten.datasets.isolated import read_isolated
    from foten.editing.height_map import heights_of, imagined, tool_of
    from foten.models.foten_plus.config import FotenPlusConfig
    from foten.models.foten_plus.sizes import FotenPlusSizes
    from foten.models.trainable import train
    from foten.training.job import TrainingJob
    from foten.training.loop import Monitor

    pixels = read_isolated("picture", picture)[1][0]
    try:
        heights = heights_of(pixels, scale, depth)
    except ValueError as error:
        raise ValueError(f"{picture.name}: {error}") from error
    say(f"stroking {picture.name}, {heights.shape[1] * scale:.3g} × {heights.shape[0] * scale:.3g} mm, {seconds:g} s …")
    recording = replace(imagined(heights, scale, tool_of(**tool), tiles, seconds, seed), texture=picture.stem)
    job = TrainingJob(recording, "foten-plus", FotenPlusSizes(), FotenPlusConfig(seed=seed))
    trained = train(job, Monitor(lambda stage: say(f"{stage} …"))).texture
    evidence = f"height map {picture.name}, {scale:g} mm a pixel, {depth:g} mm deep, {recording.tool}, {UNMEASURED}"
    return Texture({**trained.card, "evidence": evidence}, trained.tensors)
