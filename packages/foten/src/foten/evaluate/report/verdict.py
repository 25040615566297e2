"""The verdict: the figures of a judgement in plain language, and how much of it the data bear."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from foten.dsp.level import frame_means
from foten.evaluate.evaluate import Judgement
from foten.evaluate.report.signals import frame_errors, scored_conditions, shown_run
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.recording.inspection.speed_force import EXTREMES
from foten.recording.recording import counted, range_in_words
from foten.reporting.table import minus, signed


@dataclass(frozen=True)
class Finding:
    """Part of the verdict."""

    tone: str  # `good`, `even`, `bad` or `unknown`
    title: str  # what was judged
    figure: str  # the number, with unit
    beside: str  # what it is compared with, short
    sentence: str  # the same in plain language


Interval = Sequence[float] | None
MAX_LEVEL_DB = 3.0  # that a level may be off in a range of speeds which counts as usable
SILENT_DB = -10.0  # below the recording all is taken as silence
SPEED_RANGES = 3  # of as many frames each
FEW_BLOCKS = 5  # that judge, below which there are no intervals


def _finding(
    tone: str, title: str, figure: str, beside: str, sentence: str, interval: Interval, holds: Callable[[float], bool]
) -> Finding:
    """Finding, unless it praises what the data do not bear.

    `interval` is of its number, None with too few blocks for one; `holds` is whether a number at an end of it would not
    contradict a good mark.
    """
    borne = tone not in ("good", "even") if interval is None else tone != "good" or all(map(holds, interval))
    if borne:
        return Finding(tone, title, figure, beside, sentence)
    # Where there are no intervals at all, a caution says so once.
    wide = "" if interval is None else " The blocks are too few to be sure of that: its 95 % interval reaches further."
    return Finding("unknown", title, figure, f"too little data to say; {beside}", sentence + wide)


def _unknown(title: str, what: str, document: Mapping[str, Any], key: str) -> Finding:
    why = reason(document, key)
    return Finding("unknown", title, "–", why, f"{title}: {what} ({why}).")


def _interval(scores: Mapping[str, Any], key: str) -> Interval:
    return (scores.get("intervals") or {}).get(key)


def reason(document: Mapping[str, Any], *keys: str) -> str:
    """First reason that a document gives under some keys."""
    return next((str(document["reasons"][key]) for key in keys if key in document["reasons"]), "not known")


def ar_name(best: Mapping[str, Any]) -> str:
    """Name of the best linear predictor: its order, and whether it is scheduled."""
    return f"AR({best['order']})" + (" following speed and force" if best["scheduled"] else "")


def verdict(document: Mapping[str, Any]) -> list[Finding]:
    """Findings of a document: one step, then spectrum, level and dynamics of the free run, and the listener."""
    # The run that stands for the texture: with excitation where there is one.
    key = "free_run" if document["free_run"]["lsd_db"] is not None else "free_run_deterministic"
    if document[key]["lsd_db"] is None:
        return [_one_step(document), _unknown("Free run", "not scored", document, "free_run")]
    findings = [_one_step(document), _spectrum(document, key), _level(document, key), _dynamics(document, key)]
    with_listener = document.get("listener") or "listener" in document["reasons"]
    return [*findings, *(_listeners(document) if with_listener else [])]


def headline(judgement: Judgement) -> str:
    """What a texture is good for, in a line of plain words; first, where it is so, that its training has not ended."""
    early = judgement.document.get("unfinished")
    return f"{early[0].upper()}{early[1:]}. {_good_for(judgement)}" if early else _good_for(judgement)


def _good_for(judgement: Judgement) -> str:
    document, key = judgement.document, shown_run(judgement)
    if key is None:
        return f"Not judged: {reason(document, 'free_run')}."
    if document[key]["level_bias_db"] is None:
        return f"Not judged: {reason(document, f'{key}.level_bias_db')}."
    ranges = _levels_by_speed(judgement, key)
    if not ranges:
        return "Not judged: the tool hardly moves, or hardly presses, in this recording."
    one_step, spectrum, _, dynamics, *_ = verdict(document)
    zero, foreign = document["references"]["zero"]["mae_scaled"], document["split"] == "foreign"
    if foreign and document["one_step"]["mae_scaled"] is not None and document["one_step"]["mae_scaled"] > zero:
        return "Not this surface, or other sensors: a step ahead it is worse than silence, so the rest says little."
    biases = [bias for *_, bias in ranges]
    if max(biases) < SILENT_DB:
        others = ". foten-plus does not, nor a network with --excitation"
        is_other = key == "free_run_deterministic"
        return f"Not usable: left to itself it falls silent{others * is_other}."
    right = [abs(bias) <= MAX_LEVEL_DB for bias in biases]
    if spectrum.tone == "bad" or not any(right):
        why = f"its spectrum is {_distance(document, key)}" if any(right) else "its level is off at every speed"
        advice = "" if foreign else " Record again for longer, with strokes at all speeds and forces."
        return f"Not usable {'for this recording' if foreign else 'yet'}: {why}.{advice}"
    doubts = ["a step ahead a simple predictor is better"] * (one_step.tone == "bad")
    doubts += ["its level does not follow the hand"] * (dynamics.tone == "bad")
    doubts += [f"only {document['n_blocks']} blocks judge it"] * (document["n_blocks"] < FEW_BLOCKS)
    if all(right):
        low, high = np.maximum(np.quantile(scored_conditions(judgement)[0], EXTREMES), MOVING_SPEED)
        near = f"as near as {_ceiling(document)}" if spectrum.tone == "good" else _distance(document, key)
        worst = max(0.1, *map(abs, biases))
        usable = f"Usable{' with care' * bool(doubts)} from {range_in_words('speed', low, high)}, where it was judged"
        text = f"{usable}: level within {worst:.1f} dB at each of them, spectrum {near}"
    else:
        wrong = [one for one, fine in zip(ranges, right, strict=True) if not fine]
        low, high, bias = max(wrong, key=lambda one: abs(one[2]))
        usable = "with care"
        if right == sorted(right, reverse=True):  # the slow ones are right
            usable = f"below {min(one[0] for one in wrong):.0f} mm/s"
        elif right == sorted(right):
            usable = f"above {max(one[1] for one in wrong):.0f} mm/s"
        off = f"{abs(bias):.0f} dB too {'loud' if bias > 0 else 'soft'}"
        text = f"Usable {usable}; from {low:.0f} to {high:.0f} mm/s it is {off}"
        text += "" if foreign else ": record more strokes there"
    return f"{text}{''.join(f'; {doubt}' for doubt in doubts)}."


def _distance(document: Mapping[str, Any], key: str) -> str:
    """Distance of a run's spectrum, beside that of what it may be compared with."""
    distance, linear, ceiling = (document[run]["lsd_db"] for run in (key, "free_run_ar", "ceiling"))
    beside = (
        f" ({_ceiling(document)}: {ceiling:.1f} dB)" if ceiling else f" (AR(20): {linear:.1f} dB)" if linear else ""
    )
    return f"{distance:.1f} dB away{beside}"


def _ceiling(document: Mapping[str, Any]) -> str:
    """Whose distance the ceiling is, in a word: a second realisation's, or that of another stretch of the recording."""
    recorded = "training block" in str(document["ceiling"].get("of"))
    return "another recorded stretch's" if recorded else "a second stroke's"


def _levels_by_speed(judgement: Judgement, key: str) -> list[tuple[float, float, float]]:
    """Speeds [mm/s] between which lie as many frames of 40 ms each, and their mean level error [dB]."""
    errors, rate_hz = frame_errors(judgement, key).mean(axis=0), judgement.trace.rate_hz
    speeds, forces = (frame_means(channel, rate_hz) for channel in scored_conditions(judgement))
    moving = (speeds >= MOVING_SPEED) & (forces >= MOVING_FORCE)
    if not moving.any():
        return []
    edges = np.quantile(speeds[moving], np.linspace(0, 1, SPEED_RANGES + 1))
    number = np.clip(np.searchsorted(edges, speeds[moving], side="right") - 1, 0, SPEED_RANGES - 1)
    groups = [(i, errors[moving][number == i]) for i in range(SPEED_RANGES)]  # empty where many frames have one speed
    return [(float(edges[i]), float(edges[i + 1]), float(group.mean())) for i, group in groups if group.size]


def cautions(document: Mapping[str, Any]) -> list[str]:
    """What limits the meaning of the figures."""
    notes = []
    if document["split"] == "foreign":
        notes.append(
            "This is not the recording that the texture was trained on: all its blocks are judged, and no baseline "
            "can be fitted beside."
        )
    if (n_blocks := document["n_blocks"]) < FEW_BLOCKS:
        few = "too few for intervals, so no mark says that anything is good"
        few = "intervals are coarse" if n_blocks == 4 else few
        notes.append(f"Only {counted(n_blocks, 'block')} judged: {few}.")
    if document["ceiling"]["lsd_db"] is not None and "training block" in str(document["ceiling"].get("of")):
        notes.append("The ceiling is a recorded training block under a similar, not the same, hand: a run can pass it.")
    if cut := document["free_run"].get("n_saturated"):
        notes.append(f"The saturator cut {counted(cut, 'sample')} of the free run: the loop bursts.")
    return notes


def _one_step(document: Mapping[str, Any]) -> Finding:
    scores, references = document["one_step"], document["references"]
    error = scores["mae_scaled"]
    if error is None:
        return _unknown("One step", "not scored", document, "one_step")
    zero, persistence, linear, best, bound = (
        references[key]["mae_scaled"] for key in ("zero", "persistence", "ar", "ar_best", "bound")
    )
    caution = ""
    if linear is None:
        limit, name = min((zero, "predicting the mean"), (persistence, "persistence"))
        tone, beside = _compared(error, limit, name)
        interval = _interval(scores, "mae_scaled")
    else:
        tone, beside = _compared(error, linear, "AR(20)")
        interval, limit = _interval(scores, "mae_to_ar"), 1.0
        if tone == "bad":
            caution = " A linear predictor does this better."
        elif best is not None and error - best > 0.01 * best:
            tone, name = "even", ar_name(references["ar_best"])
            beside += f", {100 * (error / best - 1):.0f} % above {name}"
            caution = f" The best linear predictor, {name}, does this better."
    end = f"; no predictor can reach less than {bound:.3f} sd on this texture." if bound is not None else "."
    figure = f"{error:.3f} sd"
    start = f"One step: error {figure} ({scores['mae_m_s2']:.3g} {document['unit']})"
    sentence = f"{start}, {beside}{end}{caution}"
    return _finding(tone, "One step", figure, beside, sentence, interval, lambda value: value < limit)


def _compared(error: float, reference: float, name: str) -> tuple[str, str]:
    """Tone and the words of an error beside a reference's; within 1 % is even."""
    change = 100 * (error / reference - 1) if reference > 0 else 0.0
    if abs(change) < 1:
        return "even", f"within 1 % of {name}"
    return ("good", f"{-change:.0f} % below {name}") if change < 0 else ("bad", f"{change:.0f} % above {name}")


def _spectrum(document: Mapping[str, Any], key: str) -> Finding:
    distance, linear, ceiling = (document[run]["lsd_db"] for run in (key, "free_run_ar", "ceiling"))
    start = "Free run" if key == "free_run" else "Free run without excitation (the file carries none)"
    beside, words = "no ceiling known", ""
    if ceiling:
        ratio = distance / ceiling
        beside = f"{ratio:.2f} × the ceiling's {ceiling:.2f} dB"
        words = f", {ratio:.2f} × the ceiling's ({document['ceiling'].get('of') or 'unknown'})"
    if linear is not None:
        how = "above" if distance > linear else "below"
        words += f", {abs(distance - linear):.2f} dB {how} AR(20) with white noise"
        if not ceiling:
            beside = f"AR(20): {linear:.2f} dB"

    def holds(value: float) -> bool:
        return _spectrum_tone(value, ceiling, linear) != "bad" and (bool(ceiling) or linear is None or value < linear)

    tone, figure = _spectrum_tone(distance, ceiling, linear), f"{distance:.2f} dB"
    sentence, interval = f"{start}: log-spectral distance {figure}{words}.", _interval(document[key], "lsd_db")
    return _finding(tone, "Spectrum", figure, beside, sentence, interval, holds)


def _spectrum_tone(distance: float, ceiling: float | None, linear: float | None) -> str:
    """Tone of a log-spectral distance beside the ceiling's and AR(20)'s, where they are known."""
    tone = "unknown"
    if ceiling:
        tone = "good" if distance <= 1.1 * ceiling else "even" if distance <= 1.5 * ceiling else "bad"
    elif linear is not None:
        tone = "good" if distance < linear / 1.1 else "even"
    if linear is not None and distance > 1.1 * linear:
        tone = "even" if tone == "good" else "bad"
    return tone


def _level(document: Mapping[str, Any], key: str) -> Finding:
    run = document[key]
    bias, error = run["level_bias_db"], run["level_error_db"]
    if bias is None:
        return _unknown("Level", "not measured", document, f"{key}.level_bias_db")
    tone = "good" if abs(bias) <= 1 else "even" if abs(bias) <= 3 else "bad"
    side = "right on average" if abs(bias) < 0.05 else f"{abs(bias):.1f} dB too {'high' if bias > 0 else 'low'}"
    # Levels below −30 dB count as −30 dB, and a hand pauses: of a silent run the bias alone is too small.
    silent = " It all but falls silent." if bias < -10 and run["lsd_db"] > 20 else ""
    noticeable = f", {run['level_jnd']:.1f} just noticeable differences" if run.get("level_jnd") is not None else ""
    sentence = f"Level: {side}, {error:.1f} dB off in a frame of 40 ms{noticeable}.{silent}"
    figure, beside = f"{signed(bias, 1)} dB", f"{error:.1f} dB off in 40 ms frames"
    interval = _interval(run, "level_bias_db")
    return _finding(tone, "Level", figure, beside, sentence, interval, lambda value: abs(value) <= 3)


def _dynamics(document: Mapping[str, Any], key: str) -> Finding:
    correlation, best = document[key]["level_corr"], document["ceiling"]["level_corr"]
    if correlation is None:
        return _unknown("Dynamics", "no correlation of levels", document, f"{key}.level_corr")
    target = 1.0 if best is None else best
    # A ceiling of low correlation is another block under another hand, or a level that is random: no target.
    if target < 0.3:
        tone = "unknown"
    else:
        tone = "good" if correlation >= target - 0.1 else "even" if correlation >= 0.5 * target else "bad"
    beside = "1 follows every rise and fall" if best is None else f"the ceiling's is {minus(f'{best:.2f}')}"
    figure = minus(f"{correlation:.2f}")
    sentence = f"Dynamics: the level follows the recording's with a correlation of {figure} ({beside})."
    beside, interval = f"level correlation; {beside}", _interval(document[key], "level_corr")
    return _finding(tone, "Dynamics", figure, beside, sentence, interval, lambda value: value >= 0.5 * target)


def _listeners(document: Mapping[str, Any]) -> list[Finding]:
    scores = document["listener"]
    if scores is None:
        return [_unknown("Listener", "not asked", document, "listener")]
    findings = []
    # A person names the stronger of two in 75 % where they differ by a just noticeable difference: more is noticed.
    for title, kind, even in (("Listener", "", 0.3), ("A person's limits", "_person", 0.25)):
        area, control = (scores[f"listener_auc{kind}{of}"] for of in ("", "_control"))
        chance = 0.5 if control is None else max(0.5, control)
        tone = "good" if area <= chance + 0.1 else "even" if area <= chance + even else "bad"
        beside = "0.5 is chance" if control is None else f"two true vibrations: {control:.2f}"
        of_true = "" if control is None else f"; of two true vibrations in {100 * control:.0f} %"
        right = f"right in {100 * area:.0f} % of pairs of recorded and rendered half seconds"
        if kind:
            sentence = (
                f"{title}: would someone notice who knows what to look for? A network that feels levels as people do is {right} "
                f"(50 % is chance, 75 % a step of level that is just noticeable{of_true})."
            )
        else:
            sentence = (
                f"{title}: is there any difference? A network trained for it is {right} by the energies of eight bands, and in "
                f"{100 * scores['listener_auc_waveform']:.0f} % with the waveform (50 % is chance{of_true})."
            )
        findings.append(Finding(tone, title, f"{area:.2f}", beside, sentence))
    return findings
