"""The report: one self-contained HTML file with verdict, tables, figures and sound of a judgement."""

from __future__ import annotations

import base64
import html
import io
import json
import wave
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import atomic_write
from foten.dsp.resample import decimate, interpolate
from foten.evaluate import figures
from foten.evaluate.evaluate import FREE_RUN_KEYS, Judgement
from foten.texture_file import Texture

Array = NDArray[np.float64]

AUDIO_HZ = 8000
AUDIO_S = 8.0  # of each player, at most
_FADE_S = 0.004  # at block borders, so that the joints do not click
_PEAK = 0.9  # of full scale

REFERENCES = {
    "lattice": (
        "the model without its network",
        "the lattice; what the network adds is the difference to it",
    ),
    "ar": ("AR(20)", "linear, least squares on the training blocks"),
    "ar_scheduled": ("AR(20) following speed and force", "each coefficient affine in speed and force"),
    "ar_best": ("best AR", "order and scheduling chosen on the validation blocks"),
    "persistence": ("persistence", "repeats the last sample"),
    "zero": ("zero", "predicts the mean"),
    "bound": ("bound", "the best of any predictor, from the infinite past"),
    "bound_window": ("bound of a window", "the best of any predictor that sees as many samples as the model"),
}
"""One-step references, as the table calls and explains them."""

FREE_RUN_FIGURES = {
    "lsd_db": (
        "log-spectral distance",
        "dB",
        "lower",
        "RMS over frequency of the difference in dB, mean of blocks; sees gain",
    ),
    "lsd_long_db": (
        "… of pooled spectra",
        "dB",
        "lower",
        "the same on spectra pooled over all blocks: bias without scatter",
    ),
    "gfc_raw": (
        "GFC, raw bins",
        "0 to 1",
        "higher",
        "cosine of amplitude spectra (Eq. 13); two true realisations reach π/4 = 0.785; blind to gain",
    ),
    "gfc_welch": (
        "GFC, smoothed",
        "0 to 1",
        "higher",
        "the same on Welch spectra: the shape of the spectrum; blind to gain",
    ),
    "level_bias_db": (
        "level bias",
        "dB",
        "nearer 0",
        "mean level difference in frames of 40 ms: too loud (+) or too soft (−)",
    ),
    "level_error_db": ("level error", "dB", "lower", "mean absolute level difference of the same frames"),
    "level_corr": (
        "level correlation",
        "−1 to 1",
        "higher",
        "whether the level rises and falls with the recording's",
    ),
    "kurtosis": ("kurtosis", "", "nearer recorded", "3 for a Gaussian, more for a spiky vibration"),
    "max_sd": (
        "largest sample",
        "sd",
        "no outlier",
        "peak over the training standard deviation: shows a loop that bursts",
    ),
    "modulation_db": (
        "envelope spectrum",
        "dB",
        "lower",
        "log-spectral distance of the envelope, 2 to 50 Hz: roughness and rhythm",
    ),
}
"""Free-run figures: name, unit, what is better, what it says."""

_PLAIN = {"m/s^2": "m/s²"}
_TONES = {"good": "✓", "even": "≈", "bad": "✗", "unknown": "–"}


@dataclass(frozen=True)
class Finding:
    """One part of the verdict.

    Attributes:
        tone: `good`, `even`, `bad` or `unknown`.
        title: what was judged.
        figure: the number, with unit.
        beside: what it is compared with, short.
        sentence: the same in plain language.
    """

    tone: str
    title: str
    figure: str
    beside: str
    sentence: str


def write_report(judgement: Judgement, texture: Texture, directory: Path) -> Path:
    """Write `report.html` into a directory and return its path; the same judgement gives the same bytes.

    The file needs nothing beside it and nothing from a network: figures, sound and style are inside, scripts are not used.
    """
    path = directory / "report.html"
    with atomic_write(path) as part:
        part.write_text(page(judgement, texture), encoding="utf-8", newline="\n")
    return path


def page(judgement: Judgement, texture: Texture) -> str:
    """Return the report as HTML."""
    document = judgement.document
    name = document["texture"] or "unnamed texture"
    sections = [
        _header(document, texture, name),
        _verdict(document),
        _sound(judgement),
        _one_step_section(document),
        _free_run_section(document),
        _figures_section(judgement, texture),
        _raw(document, texture),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{html.escape(name)} – foten evaluate</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(section for section in sections if section)
        + "\n</main>\n</body>\n</html>\n"
    )


def verdict(document: Mapping[str, Any]) -> list[Finding]:
    """Return what the figures of a document say in plain language: one step, spectrum, level, dynamics."""
    return [_judge_one_step(document), *_judge_free_run(document)]


def _judge_one_step(document: Mapping[str, Any]) -> Finding:
    error = document["one_step"]["mae_scaled"]
    if error is None:
        why = reason(document, "one_step")
        return Finding("unknown", "One step", "–", "not scored", f"One step: not scored ({why}).")
    figure = f"{error:.3f} sd"
    start = f"One step: error {figure} ({document['one_step']['mae_m_s2']:.3g} m/s²)"
    references = document["references"]
    bound = references["bound"]["mae_scaled"]
    end = f"; no predictor can reach less than {bound:.3f} sd on this texture." if bound is not None else "."
    linear = references["ar"]["mae_scaled"]
    if linear is None:
        naive = {key: references[key]["mae_scaled"] for key in ("zero", "persistence")}
        key = min(naive, key=lambda k: naive[k])
        tone, beside = _against(
            error, naive[key], {"zero": "predicting the mean", "persistence": "persistence"}[key]
        )
        return Finding(tone, "One step", figure, beside, f"{start}, {beside}{end}")
    tone, beside = _against(error, linear, "AR(20)")
    caution = " A linear predictor does this better." if tone == "bad" else ""
    best = references["ar_best"]["mae_scaled"]
    if best is not None and tone != "bad" and (error - best) > 0.01 * best:
        tone, name = "even", _best_name(references["ar_best"])
        beside += f", {100 * (error / best - 1):.0f} % above {name}"
        caution = f" The best linear predictor, {name}, does this better."
    return Finding(tone, "One step", figure, beside, f"{start}, {beside}{end}{caution}")


def _best_name(best: Mapping[str, Any]) -> str:
    return f"AR({best['order']})" + (" following speed and force" if best["scheduled"] else "")


def _against(error: float, reference: float, name: str) -> tuple[str, str]:
    """Return the tone and the words of an error beside a reference's; within 1 % is even."""
    change = 100 * (error / reference - 1) if reference > 0 else 0.0
    if abs(change) < 1:
        return "even", f"within 1 % of {name}"
    return (
        ("good", f"{-change:.0f} % below {name}") if change < 0 else ("bad", f"{change:.0f} % above {name}")
    )


def _judge_free_run(document: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield spectrum, level and dynamics of the run that stands for the texture."""
    excited = document["free_run"]["lsd_db"] is not None
    run = document["free_run" if excited else "free_run_deterministic"]
    distance, linear, ceiling = (r["lsd_db"] for r in (run, document["free_run_ar"], document["ceiling"]))
    if distance is None:
        why = reason(document, "free_run")
        yield Finding("unknown", "Free run", "–", "not scored", f"Free run: not scored ({why}).")
        return
    start = "Free run" if excited else "Free run without excitation (the file carries none)"
    tone, beside, words = "unknown", "no ceiling known", ""
    if ceiling:
        ratio = distance / ceiling
        tone = "good" if ratio <= 1.1 else "even" if ratio <= 1.5 else "bad"
        beside = f"{ratio:.2f} × the ceiling's {ceiling:.2f} dB"
        words = f", {ratio:.2f} × the ceiling's ({document['ceiling'].get('of') or 'unknown'})"
    if linear is not None:
        how = "above" if distance > linear else "below"
        words += f", {abs(distance - linear):.2f} dB {how} AR(20) with white noise"
        if not ceiling:
            beside = f"AR(20): {linear:.2f} dB"
            tone = "good" if distance < linear / 1.1 else "even"
        if distance > 1.1 * linear:
            tone = "even" if tone == "good" else "bad"
    yield Finding(
        tone,
        "Spectrum",
        f"{distance:.2f} dB",
        beside,
        f"{start}: log-spectral distance {distance:.2f} dB{words}.",
    )
    bias, error = run["level_bias_db"], run["level_error_db"]
    tone = "good" if abs(bias) <= 1 else "even" if abs(bias) <= 3 else "bad"
    side = (
        "right on average" if abs(bias) < 0.05 else f"{abs(bias):.1f} dB too {'high' if bias > 0 else 'low'}"
    )
    # Levels count from −30 dB on and a recording rests now and then, so that the bias alone understates silence.
    silent = " It all but falls silent." if bias < -10 and distance > 20 else ""
    yield Finding(
        tone,
        "Level",
        f"{_signed(bias, 1)} dB",
        f"{error:.1f} dB off in 40 ms frames",
        f"Level: {side}, {error:.1f} dB off in a frame of 40 ms.{silent}",
    )
    follows, best = run["level_corr"], document["ceiling"]["level_corr"]
    if follows is None:
        why = reason(document, "free_run.level_corr" if excited else "free_run_deterministic.level_corr")
        yield Finding("unknown", "Dynamics", "–", why, f"Dynamics: no correlation of levels ({why}).")
        return
    # A ceiling that does not follow is another block under another hand, or a level that is all chance.
    if best is not None and best < 0.3:
        tone = "unknown"
    else:
        target = best if best is not None else 1.0
        tone = "good" if follows >= target - 0.1 else "even" if follows >= 0.5 * target else "bad"
    beside = (
        f"the ceiling's is {_minus(format(best, '.2f'))}"
        if best is not None
        else "1 follows every rise and fall"
    )
    yield Finding(
        tone,
        "Dynamics",
        _minus(f"{follows:.2f}"),
        f"level correlation; {beside}",
        f"Dynamics: the level follows the recording's with a correlation of {_minus(format(follows, '.2f'))} ({beside}).",
    )


def cautions(document: Mapping[str, Any]) -> list[str]:
    """Return what a reader should know before believing the figures."""
    found = []
    if document["split"] == "foreign":
        found.append(
            "This is not the recording that the texture was trained on: all its blocks are judged, and no baseline "
            "can be fitted beside."
        )
    if document["n_blocks"] < 5:
        found.append(
            f"Only {document['n_blocks']} block{'s' * (document['n_blocks'] != 1)} judged: intervals are missing or coarse."
        )
    if document["ceiling"]["lsd_db"] is not None and "training block" in str(document["ceiling"].get("of")):
        found.append(
            "The ceiling is a recorded training block under a similar, not the same, hand: a good run can lie beyond it."
        )
    cut = document["free_run"].get("n_saturated") or 0
    if cut:
        found.append(f"The saturator cut {cut} sample{'s' * (cut != 1)} of the free run: the loop bursts.")
    return found


def reason(document: Mapping[str, Any], *keys: str) -> str:
    """Return the first reason that a document gives under some keys."""
    return next((str(document["reasons"][key]) for key in keys if key in document["reasons"]), "not known")


class _Table:
    """Cells of one table: numbers in full beside their rounding, dashes with a footnote."""

    def __init__(self, document: Mapping[str, Any], letter: str) -> None:
        self.document, self.letter, self.notes = document, letter, list[str]()

    def number(
        self, value: float | None, text: str, why: str, interval: list[float] | None = None, digits: int = 3
    ) -> str:
        if value is None:
            if why not in self.notes:
                self.notes.append(why)
            mark = f"{self.letter}{self.notes.index(why) + 1}"
            return f'<td class="n none"><abbr title="{html.escape(why)}">–</abbr><sup>{mark}</sup></td>'
        small = (
            f"<small>{interval[0]:.{digits}f} … {interval[1]:.{digits}f}</small>".replace("-", "−")
            if interval
            else ""
        )
        return f'<td class="n"><data value="{value!r}">{text}</data>{small}</td>'

    def footnotes(self) -> str:
        items = (f"<sup>{self.letter}{k}</sup> {html.escape(note)}" for k, note in enumerate(self.notes, 1))
        return f'<p class="notes">{" · ".join(items)}</p>' if self.notes else ""


def _one_step_section(document: Mapping[str, Any]) -> str:
    table = _Table(document, "a")
    references = document["references"]
    linear = references["ar"]["mae_scaled"]
    rows = {"one_step": (document["model"], "this texture", document["one_step"])}
    rows |= {
        f"references.{key}": (*REFERENCES[key], references[key]) for key in REFERENCES if key in references
    }
    largest = (
        max((row["mae_scaled"] for *_, row in rows.values() if row["mae_scaled"] is not None), default=1.0)
        or 1.0
    )
    body = []
    for key, (name, what, row) in rows.items():
        if key == "references.ar_best" and row.get("order") is not None:
            name += f": {_best_name(row)}"
        family = ("references.ar",) if key.startswith("references.ar") else ()
        why = reason(document, key, *family, "one_step")
        why_gfc = (
            "a bound on the error says nothing of the spectrum" if row["mae_scaled"] is not None else why
        )
        within = row.get("intervals") or {}
        mae, physical, fit = row["mae_scaled"], row["mae_m_s2"], row["gfc"]
        bar = "" if mae is None else f'<span class="bar" style="width:{100 * mae / largest:.1f}%"></span>'
        ratio = f"{_signed(100 * (mae / linear - 1), 1)} %" if mae is not None and linear else ""
        body.append(
            f'<tr id="{key}"{" class=own" if key == "one_step" else ""}>'
            f'<th scope="row">{html.escape(name)}<small>{html.escape(what)}</small></th>'
            + table.number(mae, f"{mae:.4f}" if mae is not None else "", why, within.get("mae_scaled"))
            + f'<td class="bars">{bar}</td><td class="n">{ratio}</td>'
            + table.number(physical, f"{physical:#.4g}" if physical is not None else "", why)
            + table.number(fit, f"{fit:.3f}" if fit is not None else "", why_gfc, within.get("gfc"))
            + "</tr>"
        )
    one = document["one_step"]
    excitation = ""
    if one.get("nll") is not None:
        excitation = (
            f"<p>The excitation, its scale and tails, against the error of what a rendering expects of the next sample: "
            f"<b>{100 * one['coverage_50']:.0f} %</b> of "
            f"the samples inside its central 50 %, <b>{100 * one['coverage_90']:.0f} %</b> inside its 90 %; errors taken "
            f"back through scale and tails have standard deviation <b>{one['standardised_sd']:.2f}</b> (1 when they are right); "
            f"negative log-likelihood "
            f"{_minus(format(one['nll'], '.3f'))} nat.</p>"
        )
    return (
        '<section id="one-step"><h2>One step</h2><p>Predicts each sample from recorded history. Errors are mean '
        f"absolute errors; 1 sd is {document['sd_m_s2']:.4g} m/s². The first {document['first_scored']} samples of each "
        "block are history for all. Small print: 95 % interval, resampling blocks. The blocks are the same for all, so two rows "
        "can differ for certain though their intervals overlap.</p>"
        '<div class="scroll"><table><thead><tr><th>predictor</th><th colspan="2">error [sd] <i>lower is better</i></th>'
        "<th>to AR(20)</th><th>error [m/s²]</th><th>GFC <i>higher, blind to gain</i></th></tr></thead>"
        f"<tbody>{''.join(body)}</tbody></table></div>{table.footnotes()}{excitation}</section>"
    )


def _free_run_section(document: Mapping[str, Any]) -> str:
    table = _Table(document, "b")
    runs = ("free_run", "free_run_deterministic", "free_run_ar", "ceiling")
    recorded = next(
        (
            r["kurtosis_recorded"]
            for r in map(document.get, runs)
            if r and r.get("kurtosis_recorded") is not None
        ),
        None,
    )
    keys = [*FREE_RUN_KEYS, *(key for key in FREE_RUN_FIGURES if key not in FREE_RUN_KEYS)]
    body = []
    for key in keys:
        name, unit, better, what = FREE_RUN_FIGURES.get(key, (key, "", "", ""))
        own = f" Recorded: {recorded:.2f}." if key == "kurtosis" and recorded is not None else ""
        title = html.escape(name) + (f" <i>[{html.escape(unit)}]</i>" if unit else "")
        cells = []
        for run in runs:
            value = document[run].get(key)
            why = reason(document, f"{run}.{key}", run, "free_run")
            digits = 1 if value is not None and abs(value) >= 30 else 2
            text = (
                ""
                if value is None
                else _signed(value, digits)
                if "bias" in key
                else _minus(f"{value:.{digits}f}")
            )
            if value is not None and key == "max_sd" and value < 0.01:
                text = f"{value:.1g}"
            interval = (document[run].get("intervals") or {}).get(key)
            cells.append(table.number(value, text, why, interval, digits))
        body.append(
            f'<tr id="free_run.{key}"><th scope="row">{title}<small>{html.escape(what)}.{own}</small></th>'
            f'<td class="better">{better}</td>{"".join(cells)}</tr>'
        )
    of = document["ceiling"].get("of")
    heads = {
        "free_run": document["model"],
        "free_run_deterministic": "the model alone, no noise",
        "free_run_ar": "AR(20) and white noise of one scale",
        "ceiling": of or "not known",
    }
    titles = "".join(
        f"<th>{html.escape(figures.LABELS[run])}<small>{html.escape(heads[run])}</small></th>" for run in runs
    )
    return (
        '<section id="free-run"><h2>Free run</h2><p>Synthesized under the recorded speed and force, its own output as '
        "history, and compared with what was recorded; the first fifth of each block is not scored. The ceiling says "
        'what a true vibration of the same texture reaches.</p><div class="scroll"><table><thead><tr><th>figure</th>'
        f"<th>better</th>{titles}</tr></thead>"
        f"<tbody>{''.join(body)}</tbody></table></div>{table.footnotes()}{_slopes(document)}</section>"
    )


def _slopes(document: Mapping[str, Any]) -> str:
    run = (
        document["free_run"]
        if document["free_run"].get("level_slopes")
        else document["free_run_deterministic"]
    )
    ours, theirs = run.get("level_slopes"), run.get("level_slopes_recorded")
    if not ours or not theirs:
        return ""
    return (
        f"<p>How the level grows with the hand: <b>{_signed(ours[0], 1)}</b> dB per decade of speed (recorded "
        f"{_signed(theirs[0], 1)}), <b>{_signed(ours[1], 1)}</b> dB per decade of force (recorded "
        f"{_signed(theirs[1], 1)}).</p>"
    )


def _header(document: Mapping[str, Any], texture: Texture, name: str) -> str:
    card, block_ms = texture.card, 1000 * document["block"] / document["rate_hz"]
    split = document["split"]
    if document["split_sha256"]:
        split = f"{split} {document['split_sha256'][:10]}"
    (slow, fast), (light, heavy) = (texture.trained_range(channel) for channel in ("speed", "force"))
    facts = {
        "model": document["model"],
        "rate": f"{document['rate_hz']:g} Hz",
        "judged": f"{document['n_blocks']} blocks of {block_ms:g} ms",
        "split": split,
        "seed": document["seed"],
        "recorded sd": f"{document['sd_m_s2']:.4g} m/s²",
        "trained range": f"{slow:.0f}–{fast:.0f} mm/s, {light:.2f}–{heavy:.2f} N",
        "tool": card["tool"] or "not stated",
        "sensors": card["sensors"] or "not stated",
        "notes": card["notes"] or "none",
        "licence": card["licence"] or "not stated",
        "texture file": document["texture_sha256"][:10],
        "recording": document["recording_sha256"][:10],
    }
    items = "".join(
        f"<div><dt>{key}</dt><dd>{html.escape(str(value))}</dd></div>" for key, value in facts.items()
    )
    return f"<header><p class=kicker>foten evaluate</p><h1>{html.escape(name)}</h1><dl>{items}</dl></header>"


def _verdict(document: Mapping[str, Any]) -> str:
    findings = verdict(document)
    cards = "".join(
        f'<div class="card {f.tone}"><h3>{f.title} <span class="mark">{_TONES[f.tone]}</span></h3>'
        f"<b>{html.escape(f.figure)}</b><small>{html.escape(f.beside)}</small></div>"
        for f in findings
    )
    sentences = " ".join(html.escape(f.sentence) for f in findings)
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in cautions(document))
    return (
        f'<section id="verdict"><div class="cards">{cards}</div><p>{sentences}</p>'
        + (f'<ul class="cautions">{notes}</ul>' if notes else "")
        + "</section>"
    )


def _sound(judgement: Judgement) -> str:
    name = figures.shown_run(judgement)
    if name is None:
        return ""
    recorded, synthesized, full_scale = sounds(judgement, name)
    labels = ("recorded", f"synthesized ({figures.LABELS[name]})")
    players = ""
    for label, data in zip(labels, (recorded, synthesized), strict=True):
        text = base64.b64encode(data).decode("ascii")
        players += (
            f"<figure><figcaption>{label}</figcaption>"
            f'<audio controls loop preload="metadata" src="data:audio/wav;base64,{text}"></audio></figure>'
        )
    seconds = (len(recorded) - 44) / 2 / AUDIO_HZ
    return (
        f'<section id="sound"><h2>Listen</h2><div class="pair">{players}</div>'
        f'<p class="notes">{seconds:.1f} s of the judged blocks, joined, in a loop; both at the same gain: full scale is '
        f"{full_scale:.3g} m/s². A small loudspeaker leaves out the low part: use headphones.</p></section>"
    )


def sounds(judgement: Judgement, name: str) -> tuple[bytes, bytes, float]:
    """Return the scored blocks as recorded and as synthesized, two WAV files, and the m/s² that full scale stands for in both.

    8 kHz, 16 bit, one channel, up to 8 s; each block is faded at its ends.
    """
    rate_hz = judgement.trace.rate_hz
    recorded, _, _ = figures.scored_channels(judgement)
    n_blocks = max(1, int(AUDIO_S * rate_hz / recorded.shape[1]))
    part = recorded.shape[1]
    pair = [
        np.concatenate([_audible(block, rate_hz) for block in blocks[:n_blocks]])[: int(AUDIO_S * AUDIO_HZ)]
        for blocks in (recorded, judgement.synthesized[name][0, :, -part:])
    ]
    peak = max(float(np.abs(samples).max()) for samples in pair)
    full_scale = peak / _PEAK if peak > 0 else 1.0
    first, second = (_wav(samples / full_scale) for samples in pair)
    return first, second, full_scale


def _audible(block: Array, rate_hz: float) -> Array:
    factor = Fraction(AUDIO_HZ / rate_hz).limit_denominator(1000)
    # The rate that the factor stands for: within a thousandth of the true one, for an odd rate too.
    source_hz = AUDIO_HZ / float(factor)
    samples = interpolate(block, factor) if factor >= 1 else decimate(block, source_hz, AUDIO_HZ)
    n = min(round(_FADE_S * AUDIO_HZ), len(samples) // 2)
    ramp = (np.arange(n) + 0.5) / n
    samples[:n] *= ramp
    samples[len(samples) - n :] *= ramp[::-1]
    return samples


def _wav(samples: Array) -> bytes:
    buffer = io.BytesIO()
    with wave.open(buffer, "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(AUDIO_HZ)
        file.writeframes(np.round(samples * 32767).astype("<i2").tobytes())
    return buffer.getvalue()


def _figures_section(judgement: Judgement, texture: Texture) -> str:
    document = judgement.document
    if figures.shown_run(judgement) is None:
        why = html.escape(reason(document, "free_run"))
        return f'<section id="figures"><h2>Figures</h2><p>None: {why}.</p></section>'
    block = judgement.blocks[figures.typical_block(judgement)]
    shown, n = len(figures.shown_blocks(judgement)), len(judgement.blocks)
    some = "" if shown == n else f" {shown} of the {n} blocks, spread evenly."
    both = {"free_run", "free_run_ar"} <= judgement.synthesized.keys()
    same = " AR(20) is driven by the same noise." if both else ""
    drawn = {
        "waveform": (
            figures.waveform(judgement),
            "Waveform",
            f"The first {figures.N_WAVEFORM} scored samples of block {block}, the one of median level. "
            f"A free run is another realisation: its character should match, its samples cannot.{same}",
        ),
        "spectrum": (
            figures.spectrum(judgement),
            "Power spectral density",
            "Pooled over the scored samples of all judged blocks and all seeds: the spectra that the log-spectral distance "
            "is measured on.",
        ),
        "bands": (
            figures.bands(judgement),
            "Error in nine bands",
            "Energy against the recorded, in bands equal in log frequency; above 0 is too much.",
        ),
        "conditions": (
            figures.conditions(judgement, texture),
            "Where it is right",
            "Each judged block at its mean speed and force; red is too loud, blue too soft.",
        ),
        "time": (
            figures.over_time(judgement),
            "Over time",
            "Spectrograms of the first seed on one colour scale, level in frames of 40 ms (band: lowest to highest seed), "
            f"speed and force, on one time axis; lines mark block borders.{some}",
        ),
    }
    parts = {
        name: f'<figure id="figure-{name}"><h3>{title}</h3>{figures.inline_svg(figure, name, f"{title}. {caption}")}'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
        for name, (figure, title, caption) in drawn.items()
        if figure is not None
    }
    pair = "".join(parts.pop(name) for name in ("bands", "conditions") if name in parts)
    time = parts.pop("time")
    return f'<section id="figures"><h2>Figures</h2>{"".join(parts.values())}<div class="pair">{pair}</div>{time}</section>'


def _raw(document: Mapping[str, Any], texture: Texture) -> str:
    def block(title: str, value: Any) -> str:
        text = html.escape(json.dumps(value, indent=1, ensure_ascii=False))
        return f"<details><summary>{title}</summary><pre>{text}</pre></details>"

    return (
        '<section id="raw"><h2>Raw</h2>'
        + block("All figures (JSON)", dict(document))
        + block("The texture's card (JSON)", dict(texture.card))
        + "</section>"
    )


def _minus(text: str) -> str:
    return text.replace("-", "−")


def _signed(value: float, digits: int) -> str:
    """Return a number with its sign, a true minus, and no sign on what rounds to zero."""
    text = f"{value:+.{digits}f}"
    return _minus(text) if float(text) else f"{0:.{digits}f}"


_STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #59636e; --page: #fff; --panel: #f5f6f8; --line: #d9dde2;
  --own: #2b83cf; --good: #1a7f4b; --even: #8a6d1a; --bad: #b3362b; --unknown: #59636e; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e7eb; --soft: #9aa4af; --page: #15181c; --panel: #1e2227;
  --line: #343a42; --own: #5aa7e6; --good: #58c48a; --even: #d8b45a; --bad: #ee8478; --unknown: #9aa4af; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "Noto Sans", "DejaVu Sans", sans-serif; }
main { max-width: 1040px; margin: 0 auto; padding: 32px 24px 64px; }
h1 { font-size: 32px; line-height: 1.2; margin: 0 0 16px; overflow-wrap: anywhere; }
h2 { font-size: 20px; margin: 44px 0 8px; padding-top: 12px; border-top: 1px solid var(--line); }
h3 { font-size: 15px; margin: 0 0 4px; }
p { margin: 8px 0 12px; max-width: 78ch; }
i { font-style: normal; font-weight: 400; color: var(--soft); }
small { display: block; font-size: 12px; line-height: 1.35; font-weight: 400; color: var(--soft); }
.kicker { margin: 0; color: var(--soft); font-size: 13px; letter-spacing: .04em; }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(225px, 1fr)); gap: 8px 20px; margin: 0; }
dt { font-size: 12px; color: var(--soft); }
dd { margin: 0; overflow-wrap: anywhere; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(200px, 1fr)); gap: 12px; margin: 28px 0 16px; }
.card { background: var(--panel); border-radius: 8px; border-left: 4px solid var(--tone); padding: 12px 16px;
  break-inside: avoid; }
.card b { display: block; font-size: 25px; line-height: 1.3; font-weight: 600; font-variant-numeric: tabular-nums; }
.card h3 { color: var(--soft); font-weight: 500; }
.mark { float: right; color: var(--tone); font-weight: 700; }
.good { --tone: var(--good); } .even { --tone: var(--even); } .bad { --tone: var(--bad); } .unknown { --tone: var(--unknown); }
.cautions { margin: 8px 0; padding-left: 20px; color: var(--soft); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: 7px 10px 7px 0; border-bottom: 1px solid var(--line); }
thead th { font-size: 13px; vertical-align: bottom; border-bottom: 2px solid var(--line); }
tbody th { font-weight: 500; min-width: 200px; }
td.n { white-space: nowrap; }
td.better { color: var(--soft); font-size: 13px; white-space: nowrap; }
td.none { color: var(--soft); }
tr.own th, tr.own td { background: var(--panel); }
tr.own th { padding-left: 8px; font-weight: 700; }
td.bars { min-width: 130px; width: 18%; padding-top: 12px; }
.bar { display: block; height: 10px; border-radius: 2px; background: var(--soft); opacity: .45;
  print-color-adjust: exact; -webkit-print-color-adjust: exact; }
tr.own .bar { background: var(--own); opacity: 1; }
abbr { text-decoration: none; cursor: help; }
sup { font-size: 10px; line-height: 0; }
.notes { font-size: 12.5px; color: var(--soft); max-width: none; }
figure { margin: 20px 0; break-inside: avoid; }
figcaption { font-size: 13px; color: var(--soft); max-width: 90ch; }
figure svg { display: block; width: 100%; height: auto; overflow: visible; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(330px, 1fr)); gap: 8px 28px; }
.pair figure { margin: 8px 0; }
audio { width: 100%; margin-top: 4px; }
summary { cursor: pointer; padding: 6px 0; }
pre { background: var(--panel); padding: 12px; border-radius: 6px; overflow-x: auto; font-size: 12px; line-height: 1.4; }
@media print { :root { --ink: #000; --soft: #444; --page: #fff; --panel: #f3f3f3; --line: #ccc; }
  main { max-width: none; padding: 0; }
  body { font-size: 12px; } #sound { display: none; } tr { break-inside: avoid; } h2, h3 { break-after: avoid; } }
"""
