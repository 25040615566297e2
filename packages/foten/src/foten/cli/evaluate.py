"""`foten evaluate` and `foten info`: quality and content of a texture file."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from typer import Argument, Option

from foten.console import JsonOption, TextureFile, check_folder, preload, print_result, say
from foten.editing.describe import period_of
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.piecewise_ar.sizes import PiecewiseArSizes
from foten.models.registry import GRAPH
from foten.models.texture_file import Texture, read_texture
from foten.runtime.native import NativeTexture
from foten.untrusted import printable


def evaluate(
    texture_file: TextureFile,
    recording_files: list[Path] = Argument(
        ...,
        metavar="REC.h5…",
        help="Recording or takes that the texture was trained on (test blocks), or another recording (all blocks).",
    ),
    report: Path | None = Option(
        None, metavar="DIR", help="Folder for report.html and evaluation.json; without it, no files are written."
    ),
    seed: int = Option(0, min=0, max=2**32 - 1, help="Seed of the random excitation."),
    trim: float | None = Option(
        None, help="Time discarded at both ends of another recording (ms).", show_default="as in training"
    ),
    block: float | None = Option(
        None, help="Length of the blocks of another recording (ms).", show_default="as in training"
    ),
    listener: bool = Option(
        False, "--listener", help="Also train networks to tell the free run from the recorded surface."
    ),
    as_json: JsonOption = False,
) -> None:
    """Evaluate a texture on its test blocks, one-step and free-run, beside references (e.g. linear prediction) and a ceiling."""
    from foten.cli.simulator_reference import reference_for
    from foten.datasets.hdf5 import load_takes
    from foten.evaluate import evaluate as judge
    from foten.evaluate.report.rows import to_text
    from foten.evaluate.report.verdict import headline

    check_folder(report, "--report")
    preload(["scipy.signal"], [texture_file, *recording_files])
    texture, recording = read_texture(texture_file), load_takes(recording_files)
    if texture.unfinished:
        say(f"{texture_file.name}: {texture.unfinished}")
    with ThreadPoolExecutor() as beside:
        reference = beside.submit(reference_for, recording, texture, trim, block, listener)
        judgement = judge.evaluate(
            texture, recording, reference.result, seed, lambda stage: say(f"{stage} …"), trim, block, listener
        )
    if report is not None:
        from foten.evaluate.report.page import write_report

        say(f"wrote {write_report(judgement, texture, report)}")
    print_result(judgement.document, f"{headline(judgement)}\n\n{to_text(judgement.document)}", as_json)


def info(texture_file: TextureFile, as_json: JsonOption = False) -> None:
    """Show what a texture file holds, and check it by replaying its golden windows (stored predictions)."""
    texture = read_texture(texture_file)
    NativeTexture(texture)  # which replays the golden windows
    card = texture.card
    parts = {name: t for name, t in texture.tensors.items() if not name.startswith(("golden.", "warm_start"))}
    cost = texture.sizes.multiply_adds() or card["metrics"]["multiply_adds"]
    graph = parts.pop(GRAPH, None)
    holds = f"{sum(t.size for t in parts.values()):,} numbers"
    if graph is not None:
        holds = f"{graph.size:,} bytes for ONNX Runtime"
    unit = "in relative units," if texture.unit == "relative" else texture.unit
    rows = {
        "texture": card["texture"] or "(unnamed)",
        **({"made": texture.evidence} if texture.evidence else {}),
        **({"unfinished": texture.unfinished} if texture.unfinished else {}),
        "model": f"{card['model']}, {holds}",
        "history": f"a prediction uses the last {card['window']} samples",
        **_linear_model(texture),
        **_takes(card),
        "cost": f"{cost:,} multiply-adds per rendered sample",
        "rate": f"{texture.rate_hz:g} Hz",
        "trained range": f"{texture.trained_range_in_words()}; renderings fade {texture.fading_in_words()}",
        "above range": texture.extrapolation_in_words(),
        "acceleration": f"{texture.scaling.sd[0]:.4g} {unit} standard deviation",
        "delay": f"{card['delay_ms']:.1f} ms, from the {card['lowpass_hz']:g} Hz low-pass of speed and force",
        "excitation": "yes" if texture.has_excitation else "no",
        "validation": validation_summary(card),
        "credit": texture.credit or "(author and licence not stated)",
        "sha256": texture.sha256(),
        "proof": "golden windows (stored predictions) reproduced",
    }
    text = "\n".join(f"{name:14s}{printable(value)}" for name, value in rows.items())
    print_result({"sha256": texture.sha256(), **card}, text, as_json)


def _linear_model(texture: Texture) -> dict[str, str]:
    """Rows of `info` on the local models, or on the lattice and the tones."""
    sizes = texture.card["sizes"]
    if isinstance(texture.sizes, PiecewiseArSizes):
        zeros = f", {sizes['ma']} zeros each" if sizes["ma"] else ""
        mesh = f"on a mesh of {sizes['n_triangles']} triangles"
        return {"models": f"{sizes['n_models']} of order {sizes['order']}{zeros}, {mesh}"}
    if not isinstance(texture.sizes, FotenPlusSizes):
        return {}
    vertices = sizes["n_speed"] * sizes["n_force"]
    over = "for all speeds and forces" if vertices == 1 else f"over {vertices} pairs of speed and force"
    before_filter, tones = ", gain before the filter", "none"
    if sizes["n_tones"]:
        residual = f"residual by a lattice of order {sizes['residual_order']}"
        gain = before_filter * sizes["residual_gain_before_filter"]
        tones = f"{sizes['n_tones']} harmonics of a surface that repeats every {period_of(texture):.3g} mm; {residual}{gain}"
    parts = f"the lattice all of them, the network the last {sizes['window']}"
    return {
        "history": f"a prediction uses the last {texture.window} samples: {parts}",
        "lattice": f"order {sizes['order']}, {over}{before_filter * sizes['gain_before_filter']}",
        "tones": tones,
        "random part": random_part_summary(texture.card),
        "network": network_summary(texture.card),
        "equaliser": "eight bands, set by speed, change of speed, and force" if sizes.get("equalised") else "none",
    }


def _takes(card: Mapping[str, Any]) -> dict[str, str]:
    """Row of `info` on the takes that a texture was learned from, where there were several."""
    takes = card.get("takes") or []
    names = ", ".join(take["name"] or str(i) for i, take in enumerate(takes[:4], 1)) + ", …" * (len(takes) > 4)
    return {"takes": f"{len(takes)} ({names}), {sum(take['seconds'] for take in takes):g} s"} if takes else {}


def network_summary(card: Mapping[str, Any]) -> str:
    """Use of a foten-plus texture's network, in words."""
    metrics = card["metrics"]
    if metrics.get("n_epochs") == 0:
        return "not trained: no epoch was run"
    without = metrics.get("validation_mae_scaled_lattice")
    gain = 100 * (1 - metrics["validation_mae_scaled"] / without) if without else 0.0
    share, improves = metrics.get("mean_share", 1.0), "does not improve one-step predictions"
    if share == 0:
        improves = "does not correct one-step predictions: no gain on the validation blocks exceeded chance"
    elif gain >= 0.05:
        improves = f"improves one-step predictions by {gain:.1f} %"
        improves += f", with its mean scaled to {100 * share:.0f} %" * (share < 1)
    return improves


def random_part_summary(card: Mapping[str, Any]) -> str:
    """Random part of a foten-plus texture's renderings, in words."""
    from foten.models.foten_plus.config import WITHHELD, withholds_recording

    sizes, stored = card["sizes"], card["training"].get("recorded_innovations", "")
    if not sizes["recorded"]:
        withheld = withholds_recording(card.get("microphone", False), card["rate_hz"], stored)
        return "Gaussian noise" + f"; {WITHHELD}" * withheld
    return f"recorded innovations, {'at the speed of the hand over the recorded one' if sizes['along_path'] else 'as they were'}"


def validation_summary(card: Mapping[str, Any]) -> str:
    """Validation errors of a card, in words."""
    if card["split"] is None:
        return "none: not trained here on a recording"
    metrics = card["metrics"]
    if metrics["validation_mae_scaled"] is not None:
        return f"one-step error {metrics['validation_mae_scaled']:.4f} sd"
    distance = f"{metrics['validation_spectrum_db']:.2f} dB"
    if metrics.get("validation_spectrum_of") == "means":
        return f"mean spectra differ by {distance}"
    return f"spectra of single frames differ by {distance}, of which 4.3 dB is chance"
