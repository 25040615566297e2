"""Tables of a judgement, one-step errors and figures of the free runs: as HTML, and for a terminal."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from foten.evaluate.evaluate import RUNS
from foten.evaluate.report.signals import LABELS
from foten.evaluate.report.verdict import ar_name, reason
from foten.reporting.table import Cell, Heading, Number, Table

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
with Path(__file__).with_name("figures.csv").open(encoding="utf-8", newline="") as _file:
    FREE_RUN_FIGURES = list(csv.DictReader(_file))
"""Figures of a free run: key, name, unit, what is better, and meaning."""


def one_step_table(document: Mapping[str, Any]) -> Table:
    """One-step errors: the texture's, then the references'."""
    rows = {"one_step": (document["model"], "this texture", document["one_step"])}
    for key, (name, note) in REFERENCES.items():
        scores = document["references"][key]
        name = f"{name}: {ar_name(scores)}" if scores.get("order") is not None else name
        rows[f"references.{key}"] = (name, note, scores)
    errors = [scores["mae_scaled"] for *_, scores in rows.values() if scores["mae_scaled"] is not None]
    largest = max(errors, default=1.0) or 1.0
    columns = (
        Heading("predictor", words=True),
        Heading("error", "sd", note="lower is better"),
        Heading("to AR(20)"),
        Heading("error", document["unit"]),
        Heading("GFC", note="higher, blind to delay and gain"),
    )
    return Table(columns, tuple(_one_step_row(document, key, *row, largest) for key, row in rows.items()))


def _one_step_row(
    document: Mapping[str, Any], key: str, name: str, note: str, scores: Mapping[str, Any], largest: float
) -> tuple[Cell, ...]:
    error, intervals = scores["mae_scaled"], scores.get("intervals", {})
    bar = None if error is None else error / largest
    why = reason(document, key, *(("references.ar",) if key.startswith("references.ar") else ()), "one_step")
    why_gfc = why if error is None else "a bound on the error says nothing of the spectrum"
    if key == "references.persistence":  # 1.000, which looks like a victory
        scores, why_gfc = {**scores, "gfc": None}, "blind to delay: whatever repeats the last sample has 1"
    return (
        Heading(name, note=note, key=key, highlighted=key == "one_step"),
        Number(error, ".4f", why=why, interval=intervals.get("mae_scaled", ()), bar=bar),
        _to_linear(error, document["references"]["ar"]["mae_scaled"], intervals if key != "references.ar" else {}),
        Number(scores["mae_m_s2"], "#.4g", why=why),
        Number(scores["gfc"], interval=intervals.get("gfc", ()), why=why_gfc),
    )


def _to_linear(error: float | None, linear: float | None, intervals: Mapping[str, Any]) -> Cell:
    if error is None or not linear:
        return ""
    ends = [100 * (end - 1) for end in intervals.get("mae_to_ar", ())]
    return Number(100 * (error / linear - 1), "+.1f", interval=ends, unit=" %")


def free_run_table(document: Mapping[str, Any]) -> Table:
    """Figures of the free runs, a column for each run."""
    notes = {
        "free_run": document["model"],
        "free_run_deterministic": "the model alone, no noise",
        "free_run_ar": "AR(20) and white noise of one scale",
        "ceiling": document["ceiling"].get("of") or "not known",
    }
    kurtosis = (document[run].get("kurtosis_recorded") for run in RUNS)
    recorded = next((f" Recorded: {value:.2f}." for value in kurtosis if value is not None), "")
    rows: list[tuple[Cell, ...]] = []
    for figure in FREE_RUN_FIGURES:
        key, note = figure["key"], f"{figure['meaning']}.{recorded if figure['key'] == 'kurtosis' else ''}"
        numbers = (_free_run_number(document, run, key) for run in notes)
        rows.append((Heading(figure["name"], figure["unit"], note, f"free_run.{key}"), figure["better"], *numbers))
    columns = (Heading("figure", words=True), Heading("better", words=True))
    return Table((*columns, *(Heading(LABELS[run], note=note) for run, note in notes.items())), tuple(rows))


def _free_run_number(document: Mapping[str, Any], run: str, key: str) -> Number:
    value, interval = document[run].get(key), document[run].get("intervals", {}).get(key, ())
    digits = 1 if value is not None and abs(value) >= 30 else 2
    spec = f"{'+' if 'bias' in key else ''}.{digits}f"
    if key == "max_sd" and value is not None and value < 0.01:
        spec = ".1g"
    why = reason(document, f"{run}.{key}", run, "free_run")
    return Number(value, spec, interval=interval, why=why)


def waveform_error(document: Mapping[str, Any]) -> str:
    """Sentence on the waveform error of the free run, that of silence, and why the smaller one is not the better one."""
    key = "free_run" if document["free_run"].get("mae_scaled") is not None else "free_run_deterministic"
    error, ceiling = (document[run].get("mae_scaled") for run in (key, "ceiling"))
    if error is None:
        return ""
    silence = f"silence has {document[key]['mae_scaled_silence']:.2f}"
    another = "" if ceiling is None else f", a true vibration ({document['ceiling']['of']}) {ceiling:.2f}"
    scores, beginning = document["warm_start"]["stored"], ""
    if scores["error_to_silence_100_400_ms"] is not None:  # Fig. 6
        beginning = (
            f" From the warm start it is {scores['error_to_silence_0_100_ms']:.2f} times that of silence in the first 100 ms, "
            f"and {scores['error_to_silence_100_400_ms']:.2f} times in the 300 ms after them."
        )
    return (
        f"Waveform: the free run's mean absolute error is {error:.2f} sd; {silence}{another}. Two true vibrations differ sample "
        f"by sample, so silence wins by this figure: it is here since papers print it, and says nothing of likeness.{beginning}"
    )


def to_text(document: Mapping[str, Any]) -> str:
    """Tables of a document for a terminal, and below them what could not be computed."""
    block_ms = 1000 * document["block"] / document["rate_hz"]
    judged = f"{document['n_blocks']} blocks of {block_ms:g} ms, split {document['split']}"
    lines = [f"{document['texture'] or 'texture'}, {document['model']} at {document['rate_hz']:g} Hz: {judged}"]
    sd = f"1 sd is {document['sd_m_s2']:.4g} {document['unit']}"
    ceiling = f"; the ceiling is {document['ceiling']['of']}" if document["ceiling"].get("of") else ""
    one_step = f"One step: each sample from recorded history; mean absolute errors, lower is better; {sd}"
    free_run = f"Free run: its own output is its history{ceiling}"
    tables = {one_step: one_step_table(document), free_run: free_run_table(document)}
    missing = []
    for title, table in tables.items():
        if (known := table.known()).rows:
            lines += ["", title, *known.text()]
        if reasons := table.missing():
            grouped = "; ".join(f"{', '.join(names)} ({why})" for why, names in reasons.items())
            missing.append(f"{title.partition(':')[0]}, not computed: {grouped}.")
    if sentence := waveform_error(document):
        lines += ["", sentence]
    if scores := document.get("listener"):
        lines += ["", *_listener_lines(scores)]
    if "listener" in document["reasons"]:
        missing.append(f"Listener, not computed: areas under its curve ({reason(document, 'listener')}).")
    return "\n".join([*lines, *([""] if missing else []), *missing])


def _listener_lines(scores: Mapping[str, Any]) -> list[str]:
    control = f"; the control is {scores['listener_control_of']}" if scores["listener_control_of"] else ""
    names = {"": "band energies", "_waveform": "and the waveform", "_person": "with a person's limits"}
    areas = {name: [scores[f"listener_auc{kind}{of}"] for of in ("", "_control")] for kind, name in names.items()}
    rows = [(name, Number(area), Number(of_true)) for name, (area, of_true) in areas.items()]
    about = f"area under its curve over {scores['listener_s']:.0f} s, 0.5 is chance, 1 certainty{control}"
    return [f"Listener: {about}", *Table.of(("", "this texture", "control"), rows).text()]
