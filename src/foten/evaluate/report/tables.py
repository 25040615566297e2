"""The tables of a judgement, one-step errors beside references and figures of the free runs: as HTML, and for a terminal."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from foten.evaluate.evaluate import RUNS
from foten.evaluate.report.signals import LABELS
from foten.evaluate.report.verdict import ar_name, minus, reason, signed

REFERENCES = {
    "lattice": ("the model without its network", "the lattice; what the network adds is the difference to it"),
    "ar": ("AR(20)", "linear, least squares on the training blocks"),
    "ar_scheduled": ("AR(20) following speed and force", "each coefficient affine in speed and force"),
    "ar_best": ("best AR", "order and scheduling chosen on the validation blocks"),
    "persistence": ("persistence", "repeats the last sample"),
    "zero": ("zero", "predicts the mean"),
    "bound": ("bound", "the best of any predictor, from the infinite past"),
    "bound_window": ("bound of a window", "the best of any predictor that sees as many samples as the model"),
}
"""One-step references: name and explanation."""
FREE_RUN_FIGURES = {
    "lsd_db": ("log-spectral distance", "dB", "lower"),
    "lsd_long_db": ("… of pooled spectra", "dB", "lower"),
    "gfc_raw": ("GFC, raw bins", "0 to 1", "higher"),
    "gfc_welch": ("GFC, smoothed", "0 to 1", "higher"),
    "level_bias_db": ("level bias", "dB", "nearer 0"),
    "level_error_db": ("level error", "dB", "lower"),
    "level_corr": ("level correlation", "−1 to 1", "higher"),
    "kurtosis": ("kurtosis", "", "nearer recorded"),
    "max_sd": ("largest sample", "sd", "no outlier"),
    "modulation_db": ("envelope spectrum", "dB", "lower"),
    "emd_octaves": ("earth-mover distance", "octave", "lower"),
    "band_correlation_error": ("correlations of bands", "0 to 2", "lower"),
}
"""Figures of a free run: name, unit, and what is better."""
_MEANINGS = {
    "lsd_db": "RMS over frequency of the difference in dB, mean of blocks; sees gain",
    "lsd_long_db": "the same on spectra pooled over all blocks: bias without scatter",
    "gfc_raw": "cosine of amplitude spectra (Eq. 13); two true realisations reach π/4 = 0.785; blind to gain",
    "gfc_welch": "the same on Welch spectra: the shape of the spectrum; blind to gain",
    "level_bias_db": "mean level difference in frames of 40 ms: too loud (+) or too soft (−)",
    "level_error_db": "mean absolute level difference of the same frames",
    "level_corr": "whether the level rises and falls with the recording's",
    "kurtosis": "3 for a Gaussian, more for a spiky vibration",
    "max_sd": "peak over the training standard deviation: shows a loop that bursts",
    "modulation_db": "log-spectral distance of the envelope, 1 to 50 Hz: roughness and rhythm",
    "emd_octaves": "power moved along log frequency; people notice 0.25 to 0.3 octave; blind to gain",
    "band_correlation_error": "whether bands rise and fall in step, as under impacts; RMS difference of correlations",
}


class _Cells:
    """Number cells of one table: the full value beside its rounding, or a dash with a footnote."""

    def __init__(self, letter: str) -> None:
        self.letter, self.notes = letter, list[str]()

    def number(
        self,
        value: float | None,
        shown: Callable[[float], str],
        why: str,
        interval: Sequence[float] = (),
        digits: int = 3,
    ) -> str:
        """Return the cell of a value; `why` is the footnote where there is none."""
        if value is None:
            if why not in self.notes:
                self.notes.append(why)
            mark = f"{self.letter}{self.notes.index(why) + 1}"
            return f'<td class="n none"><abbr title="{html.escape(why)}">–</abbr><sup>{mark}</sup></td>'
        ends = " … ".join(minus(f"{end:.{digits}f}") for end in interval)
        small = f"<small>{ends}</small>" if ends else ""
        return f'<td class="n"><data value="{value!r}">{shown(value)}</data>{small}</td>'

    def footnotes(self) -> str:
        """Return the reasons of all dashes as a paragraph, empty without any."""
        items = (f"<sup>{self.letter}{k}</sup> {html.escape(note)}" for k, note in enumerate(self.notes, 1))
        return f'<p class="notes">{" · ".join(items)}</p>' if self.notes else ""


def one_step_section(document: Mapping[str, Any]) -> str:
    """Return the table of one-step errors as HTML: the texture's, then the references'."""
    cells, references = _Cells("a"), document["references"]
    rows = {"one_step": (document["model"], "this texture", document["one_step"])}
    rows |= {f"references.{key}": (*words, references[key]) for key, words in REFERENCES.items()}
    errors = [row["mae_scaled"] for *_, row in rows.values() if row["mae_scaled"] is not None]
    largest = max(errors, default=1.0) or 1.0
    body = "".join(_one_step_row(document, cells, key, *named, largest=largest) for key, named in rows.items())
    return (
        '<section id="one-step"><h2>One step</h2><p>Predicts each sample from recorded history. Errors are mean '
        f"absolute errors; 1 sd is {document['sd_m_s2']:.4g} {document['unit']}. "
        f"The first {document['first_scored']} samples of each block are history for all. Small print: 95 % interval over "
        "blocks (Student's t). The blocks are the same for all, so "
        "two rows can differ for certain though the intervals of their errors overlap: see the one to AR(20).</p>"
        '<div class="scroll"><table><thead><tr><th>predictor</th><th colspan="2">error [sd] <i>lower is better</i></th>'
        f"<th>to AR(20)</th><th>error [{document['unit']}]</th><th>GFC <i>higher, blind to delay and gain</i></th></tr></thead>"
        f"<tbody>{body}</tbody></table></div>{cells.footnotes()}{_excitation(document['one_step'])}</section>"
    )


def _one_step_row(
    document: Mapping[str, Any], cells: _Cells, key: str, name: str, what: str, row: Mapping[str, Any], largest: float
) -> str:
    name, why = _named(name, row), _why_no_error(document, key)
    mae, linear = row["mae_scaled"], document["references"]["ar"]["mae_scaled"]
    within = row.get("intervals", {})
    bar = "" if mae is None else f'<span class="bar" style="width:{100 * mae / largest:.1f}%"></span>'
    ratio = f"{signed(100 * (mae / linear - 1), 1)} %" if mae is not None and linear else ""
    if "mae_to_ar" in within and key != "references.ar":
        ends = " … ".join(signed(100 * (end - 1), 1) for end in within["mae_to_ar"])
        ratio += f"<small>{ends} %</small>"
    why_gfc = why if mae is None else "a bound on the error says nothing of the spectrum"
    return (
        f'<tr id="{key}"{" class=own" if key == "one_step" else ""}>'
        f'<th scope="row">{html.escape(name)}<small>{html.escape(what)}</small></th>'
        + cells.number(mae, "{:.4f}".format, why, within.get("mae_scaled", ()))
        + f'<td class="bars">{bar}</td><td class="n">{ratio}</td>'
        + cells.number(row["mae_m_s2"], "{:#.4g}".format, why)
        + cells.number(row["gfc"], "{:.3f}".format, why_gfc, within.get("gfc", ()))
        + "</tr>"
    )


def _named(name: str, row: Mapping[str, Any]) -> str:
    """Return the name of a one-step row, with what the best linear predictor is."""
    return f"{name}: {ar_name(row)}" if row.get("order") is not None else name


def _why_no_error(document: Mapping[str, Any], key: str) -> str:
    """Return why a one-step row has no error."""
    return reason(document, key, *(("references.ar",) if key.startswith("references.ar") else ()), "one_step")


def _excitation(one_step: Mapping[str, Any]) -> str:
    """Return how well the excitation's distribution fits the errors of a rendering's prediction, as a paragraph."""
    if one_step.get("nll") is None:
        return ""
    return (
        "<p>The excitation, its scale and tails, against the error of what a rendering expects of the next sample: "
        f"<b>{100 * one_step['coverage_50']:.0f} %</b> of "
        f"the samples inside its central 50 %, <b>{100 * one_step['coverage_90']:.0f} %</b> inside its 90 %; errors taken "
        f"back through scale and tails have standard deviation <b>{one_step['standardised_sd']:.2f}</b> (1 when they are "
        f"right); negative log-likelihood {minus(format(one_step['nll'], '.3f'))} nat.</p>"
    )


def free_run_section(document: Mapping[str, Any]) -> str:
    """Return the table of free-run figures as HTML, a column for each run."""
    cells, body = _Cells("b"), []
    kurtosis = (document[run].get("kurtosis_recorded") for run in RUNS)
    recorded = next((f" Recorded: {value:.2f}." for value in kurtosis if value is not None), "")
    for key, (name, unit, better) in FREE_RUN_FIGURES.items():
        title = html.escape(name) + (f" <i>[{html.escape(unit)}]</i>" if unit else "")
        values = "".join(_free_run_cell(document, cells, run, key) for run in RUNS)
        body.append(
            f'<tr id="free_run.{key}"><th scope="row">{title}<small>{html.escape(_MEANINGS[key])}.'
            f"{recorded if key == 'kurtosis' else ''}</small></th>"
            f'<td class="better">{better}</td>{values}</tr>'
        )
    heads = {
        "free_run": document["model"],
        "free_run_deterministic": "the model alone, no noise",
        "free_run_ar": "AR(20) and white noise of one scale",
        "ceiling": document["ceiling"].get("of") or "not known",
    }
    titles = "".join(f"<th>{LABELS[run]}<small>{html.escape(head)}</small></th>" for run, head in heads.items())
    return (
        '<section id="free-run"><h2>Free run</h2><p>Synthesized under the recorded speed and force, its own output as '
        "history, and compared with what was recorded; the first fifth of each block is not scored. The ceiling says "
        'what a true vibration of the same texture reaches.</p><div class="scroll"><table><thead><tr><th>figure</th>'
        f"<th>better</th>{titles}</tr></thead>"
        f"<tbody>{''.join(body)}</tbody></table></div>{cells.footnotes()}{_slopes(document)}</section>"
    )


def _free_run_cell(document: Mapping[str, Any], cells: _Cells, run: str, key: str) -> str:
    value, interval = document[run].get(key), document[run].get("intervals", {}).get(key, ())
    why = reason(document, f"{run}.{key}", run, "free_run")
    return cells.number(value, lambda value: _shown(key, value), why, interval, _digits(value))


def _digits(value: float | None) -> int:
    return 1 if value is not None and abs(value) >= 30 else 2


def _shown(key: str, value: float) -> str:
    """Return a figure of a free run as text."""
    if key == "max_sd" and value < 0.01:
        return f"{value:.1g}"
    return signed(value, _digits(value)) if "bias" in key else minus(f"{value:.{_digits(value)}f}")


def _slopes(document: Mapping[str, Any]) -> str:
    """Return how the level grows with speed and force, as a paragraph, empty where it is not known."""
    run = document["free_run" if document["free_run"].get("level_slopes") else "free_run_deterministic"]
    ours, theirs = run.get("level_slopes"), run.get("level_slopes_recorded")
    if not ours or not theirs:
        return ""
    return (
        f"<p>How the level grows with the hand: <b>{signed(ours[0], 1)}</b> dB per decade of speed (recorded "
        f"{signed(theirs[0], 1)}), <b>{signed(ours[1], 1)}</b> dB per decade of force (recorded "
        f"{signed(theirs[1], 1)}).</p>"
    )


def to_text(document: Mapping[str, Any]) -> str:
    """Return the figures of a document as two aligned tables for a terminal, and below them what could not be computed."""
    block_ms = 1000 * document["block"] / document["rate_hz"]
    judged = f"{document['n_blocks']} blocks of {block_ms:g} ms, split {document['split']}"
    lines = [f"{document['texture'] or 'texture'}, {document['model']} at {document['rate_hz']:g} Hz: {judged}"]
    runs = [run for run in RUNS if document[run]["lsd_db"] is not None]
    errors, figures = _errors(document), _figures(document, runs)
    if len(errors) > 1:
        sd = f"1 sd is {document['sd_m_s2']:.4g} {document['unit']}"
        about = f"each sample from recorded history; mean absolute errors, lower is better; {sd}"
        lines += ["", f"One step: {about}", *_aligned(errors)]
    if len(figures) > 1:
        ceiling = f"; the ceiling is {document['ceiling']['of']}" if document["ceiling"].get("of") else ""
        lines += ["", f"Free run: its own output is its history{ceiling}", *_aligned(figures)]
    if scores := document.get("listener"):
        lines += ["", *_listener_lines(scores)]
    missing = {"One step": _missing_errors(document), "Free run": _missing_figures(document, runs)}
    if "listener" in document["reasons"]:
        missing["Listener"] = {"areas under its curve": reason(document, "listener")}
    sentences = [f"{what}, not computed: {_grouped(why_of)}." for what, why_of in missing.items() if why_of]
    return "\n".join([*lines, *([""] if sentences else []), *sentences])


def _listener_lines(scores: Mapping[str, Any]) -> list[str]:
    """Return what listeners can tell apart, for a terminal."""
    control = scores["listener_control_of"]
    beside = f"; the control is {control}" if control else ""
    cells = [["", "this texture", "control"]]
    for key, name in (("listener_auc", "band energies"), ("listener_auc_waveform", "and the waveform")):
        values = (scores[key], scores[f"{key}_control"])
        cells.append([name, *("–" if value is None else f"{value:.3f}" for value in values)])
    about = f"area under its curve over {scores['listener_s']:.0f} s, 0.5 is chance, 1 certainty{beside}"
    lines = [f"Listener: {about}", *_aligned(cells)]
    if biases := scores.get("level_bias_db"):
        by_speed = ", ".join(f"{value:+.2f}" for value in biases.values())
        lines += [
            f"Level beside the recorded one, from the slowest quarter of that stroke to the fastest: {by_speed} dB"
        ]
    return lines


def _errors(document: Mapping[str, Any]) -> list[list[str]]:
    """Return the one-step errors that are known as cells, their heading first."""
    rows = {f"{document['model']}, this texture": document["one_step"]}
    for key, (name, _) in REFERENCES.items():
        rows[_named(name, document["references"][key])] = document["references"][key]
    cells = [["", "error [sd]", f"error [{document['unit']}]", "GFC"]]
    for name, row in rows.items():
        if row["mae_scaled"] is not None:
            fit = "–" if row["gfc"] is None else f"{row['gfc']:.3f}"
            cells.append([name, f"{row['mae_scaled']:.4f}", f"{row['mae_m_s2']:#.4g}", fit])
    return cells


def _figures(document: Mapping[str, Any], runs: Sequence[str]) -> list[list[str]]:
    """Return the figures of some free runs that any of them has as cells, their heading first."""
    cells = [["", "better", *(LABELS[run] for run in runs)]]
    for key, (name, unit, better) in FREE_RUN_FIGURES.items():
        values = [document[run].get(key) for run in runs]
        if any(value is not None for value in values):
            shown = ("–" if value is None else _shown(key, value) for value in values)
            cells.append([name + (f" [{unit}]" if unit else ""), better, *shown])
    return cells


def _aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the rows of a table: the first column, and words, from the left, numbers and their headings from the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [
            cell.ljust(width) if k == 0 or rows[0][k] == "better" else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield "  ".join(cells).rstrip()


def _missing_errors(document: Mapping[str, Any]) -> dict[str, str]:
    """Return which one-step errors there are not, and why."""
    if document["one_step"]["mae_scaled"] is None and "one_step" in document["reasons"]:
        missing = {"this texture": reason(document, "one_step")}
    else:
        missing = {}
    unknown = {key: name for key, (name, _) in REFERENCES.items() if document["references"][key]["mae_scaled"] is None}
    return missing | {name: _why_no_error(document, f"references.{key}") for key, name in unknown.items()}


def _missing_figures(document: Mapping[str, Any], runs: Sequence[str]) -> dict[str, str]:
    """Return which free runs there are not, which of their figures, and why; `runs` are those that there are."""
    missing = {LABELS[run]: reason(document, run, "free_run") for run in RUNS if run not in runs}
    for key, (name, *_) in FREE_RUN_FIGURES.items():
        lacking = [run for run in runs if document[run].get(key) is None]
        for run in lacking:
            shown = name if len(lacking) == len(runs) else f"{name} {LABELS[run]}"
            missing[shown] = reason(document, f"{run}.{key}")
    return missing


def _grouped(why_of: Mapping[str, str]) -> str:
    """Return things that are missing, those of one reason together."""
    by_reason: dict[str, list[str]] = {}
    for name, why in why_of.items():
        by_reason.setdefault(why, []).append(name)
    return "; ".join(f"{', '.join(names)} ({why})" for why, names in by_reason.items())
