"""The result of a training, as `foten train` and `foten info` print it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from foten.cli.console import print_json

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from foten.families.texture_file import Texture
    from foten.recording.trace import Trace


def print_training_result(
    texture: Texture,
    trace: Trace,
    output: Path,
    recording_file: Path,
    as_json: bool,
    interrupted: bool = False,
    folder: Path | None = None,
) -> None:
    """Print the result of a training."""
    card, metrics = texture.card, texture.card["metrics"]
    if as_json:
        print_json(
            {
                "output": str(output),
                "sha256": texture.sha256(),
                "interrupted": interrupted,
                "n_blocks": trace.n_blocks,
                "n_samples_dropped": trace.n_dropped,
                "n_samples_uncovered": trace.n_uncovered,
                "split_sha256": card["split_sha256"],
                **metrics,
            }
        )
        return
    summary = [f"validation blocks: {validation_summary(card)}"]
    if card["model"] == "ar":
        sizes = card["sizes"]
        summary[0] += f", order {sizes['order']}"
        summary.append(f"{sizes['n_models']} models from {metrics['n_pieces']} pieces, those around it counted")
        if metrics["n_pieces_left_out"]:
            summary.append(f"{metrics['n_pieces_left_out']} pieces that do not vibrate left out")
    else:
        summary[0] += f" (epoch {metrics['best_epoch']})"
    if metrics.get("validation_mae_scaled_lattice") is not None:
        summary.append(f"{metrics['validation_mae_scaled_lattice']:.4f} sd without its network")
    print(", ".join(summary))
    if trace.n_uncovered:
        print(f"{trace.n_uncovered} samples that not every channel covers were left out")
    if trace.n_dropped:
        print(f"{trace.n_dropped} samples at the end did not fill a block and were left out")
    condition = card["warm_start"]["recorded"]
    origin = "modelled" if card["model"] == "ar" else "recorded"
    print(
        f"warm start {origin} at {condition['speed']:.0f} mm/s and {condition['force']:.2f} N (asked: 45 mm/s, 0.8 N)"
    )
    outputs = f"{output} and {folder}" if folder is not None else f"{output}"
    print(f"wrote {outputs}; next: foten evaluate {output} {recording_file}")


def validation_summary(card: Mapping[str, Any]) -> str:
    """Return the validation errors that a card holds, in words."""
    if card["split"] is None:
        return "none here: its models were imported"
    metrics = card["metrics"]
    if metrics["validation_mae_scaled"] is None:
        return _spectrum_summary(card)
    text = f"{metrics['validation_mae_scaled']:.4f} sd one-step"
    if metrics.get("validation_mae_scaled_hop") is not None:
        text += f", {metrics['validation_mae_scaled_hop']:.4f} sd on the mean of a hop"
    return text


def _spectrum_summary(card: Mapping[str, Any]) -> str:
    """Return the validation error of a model of spectra, in words."""
    distance = f"{card['metrics']['validation_spectrum_db']:.2f} dB"
    if card["model"] == "gan":
        return f"mean spectra missed by {distance}"
    return f"spectra of single frames missed by {distance}, of which chance alone is 4.3"
