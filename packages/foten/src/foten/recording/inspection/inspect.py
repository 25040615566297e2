"""All checks of a recording, in one call."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from foten.dsp import perception
from foten.dsp.level import rms
from foten.recording.inspection import one_channel, sampling
from foten.recording.inspection.speed_force import (
    SpeedForce,
    at_rest,
    check_contact,
    check_ranges,
    check_signs,
    coverage_of,
    speed_force_of,
)
from foten.recording.inspection.values import PROBLEM, UNUSABLE, ChannelReport, Finding, Inspection
from foten.recording.preprocess import (
    MIN_ALONE_S,
    SHORT_BLOCKS_MS,
    PreprocessConfig,
    fitting_cut,
    fitting_options,
    preprocess,
)
from foten.recording.recording import Channel, Recording, common_span_s
from foten.recording.scaling import fit_scaling
from foten.recording.split import MIN_BLOCKS

OF_ALL_TAKES = ("range", "coverage", "short")  # codes of what one take may lack and another have


def inspect_recording(recording: Recording, is_trained: bool = False) -> Inspection:
    """Numbers of each channel, findings, and the coverage of speed and force, of all takes together.

    What a training refuses is left out where that follows (`is_trained`), and says so itself.
    """
    if not recording.later_takes:
        inspection = _inspected(recording, is_trained)[0]
        is_cut = not inspection.unusable and "--block" not in inspection.options
        return replace(inspection, cut_ms=fitting_cut(recording)) if is_cut else inspection
    takes = recording.takes
    inspections, hands = zip(*(_inspected(take, is_trained) for take in takes), strict=True)
    findings = _findings_of(takes, inspections)
    coverage = None
    if known := [hand for hand in hands if hand is not None]:
        joined = (np.concatenate([getattr(hand, name) for hand in known]) for name in ("times_s", "speed", "force"))
        coverage = coverage_of(SpeedForce(*joined))
    if coverage is not None:
        findings += check_ranges(coverage)
    longest = max(range(len(takes)), key=lambda i: takes[i].duration_s)
    psd, shares = inspections[longest].psd, inspections[longest].carried
    cut_ms, shortest_ms = fitting_cut(recording), SHORT_BLOCKS_MS[-1]  # which a higher rate may take
    lost_ms = 2 * cut_ms[0] + PreprocessConfig().delay_ms
    n_blocks = sum(max(0, int((1000 * take.duration_s - lost_ms) // shortest_ms)) for take in takes)
    if n_blocks < MIN_BLOCKS:
        blocks = f"{len(takes)} takes hold {n_blocks} blocks of {shortest_ms:g} ms"
        findings.append(Finding(UNUSABLE, "short", "", f"{blocks}, expected {MIN_BLOCKS} or more: record for longer"))
    rate_hz = perception.smallest_rate(shares) if shares else PreprocessConfig().rate_hz
    options = f"--rate {rate_hz:g}"
    reports = tuple(map(_pooled, zip(*(inspection.channels for inspection in inspections), strict=True)))
    about = psd, shares, options, recording.sha256()
    lengths_s = tuple(take.duration_s for take in takes)
    return Inspection(reports, tuple(findings), coverage, *about, lengths_s, cut_ms)


def _findings_of(takes: Sequence[Recording], inspections: Sequence[Inspection]) -> list[Finding]:
    """Findings of some takes, with the take; what several have in common is said once."""
    places: dict[tuple[str, str, str], list[tuple[int, Finding]]] = {}
    for i, inspection in enumerate(inspections, 1):
        for finding in inspection.findings:
            if finding.code not in OF_ALL_TAKES:
                places.setdefault((finding.severity, finding.code, finding.channel), []).append((i, finding))
    findings = []
    for found in places.values():
        (number, first), n = found[0], len({i for i, _ in found})
        if first.severity == UNUSABLE and n < len(takes):  # the others can be learned from
            first = replace(first, severity=PROBLEM, text=f"{first.text}: leave this take out")
        others = f" (so in {n} of {len(takes)} takes)" if n > 1 else ""
        findings.append(
            replace(first, text=f"take {number}{takes[number - 1].named}: {first.text}{others}", take=number)
        )
    return findings


def _pooled(reports: Sequence[ChannelReport]) -> ChannelReport:
    """Numbers of one channel in all takes."""
    n = np.array([report.n_samples for report in reports])
    loudest = max(reports, key=lambda report: report.noise_floor)
    return replace(
        loudest,
        rate_hz=reports[0].rate_hz,
        regular=all(report.regular for report in reports),
        n_samples=int(n.sum()),
        duration_s=sum(report.duration_s for report in reports),
        minimum=min(report.minimum for report in reports),
        maximum=max(report.maximum for report in reports),
        mean=float(np.average([report.mean for report in reports], weights=n)),
        rms=float(np.sqrt(np.average(np.square([report.rms for report in reports]), weights=n))),
    )


def _inspected(recording: Recording, is_trained: bool) -> tuple[Inspection, SpeedForce | None]:
    """Inspection of a single take, and its speed and force."""
    named, findings, of_channels = recording.channels.items(), list[Finding](), list[Finding]()
    for name, channel in named:  # which take no library, while others are imported
        of_channels += one_channel.check_units(name, channel, recording)
        of_channel = (sampling.check_gaps, one_channel.check_spikes, one_channel.check_clipping, sampling.check_repeats)
        of_channels += [finding for check in of_channel for finding in check(name, channel)]
    speed_force = None
    try:
        speed_force = speed_force_of(recording)
    except ValueError as error:
        findings.append(Finding(UNUSABLE, "refused", "", f"training refuses it: {error}"))
    reports = tuple(_report(name, channel, recording.unit(name), speed_force) for name, channel in named)
    findings += sampling.check_missing(recording)
    findings += sampling.check_durations(recording)
    findings += of_channels
    findings += sampling.check_order(recording)
    psd = {}
    for name, channel in named:
        if name.startswith("acceleration"):
            findings += one_channel.check_whiteness(name, channel)
            if channel.samples.size >= 64:
                psd[name] = one_channel.density(channel)
                findings += one_channel.check_lines(name, *psd[name])
    findings += check_signs(recording)
    findings += check_contact(recording, speed_force)
    findings += one_channel.check_noise(reports)
    coverage = None if speed_force is None else coverage_of(speed_force)
    if coverage is not None:
        findings += check_ranges(coverage)
    elif speed_force is not None:
        findings.append(at_rest(speed_force))
    captured_hz = min((recording[name].rate_hz for name in psd), default=None)
    shares = {} if captured_hz is None else perception.carried(psd, captured_hz)
    rate_hz = perception.smallest_rate(shares) if shares else PreprocessConfig().rate_hz
    start_s, end_s = common_span_s(recording.channels.values())
    options = f"--rate {rate_hz:g}"
    if end_s - start_s < MIN_ALONE_S:
        options = fitting_options(end_s - start_s, rate_hz, captured_hz)
    findings += sampling.check_short(end_s - start_s, options)
    is_tried = not is_trained and speed_force is not None and not any(finding.code == "short" for finding in findings)
    if is_tried and captured_hz is not None:
        findings += _refused(recording, min(captured_hz, PreprocessConfig().rate_hz))
    inspection = Inspection(reports, tuple(findings), coverage, psd, shares, options, recording.sha256())
    return inspection, speed_force


def _refused(recording: Recording, rate_hz: float) -> Iterable[Finding]:
    """Yield what training would refuse, by doing the same."""
    try:
        trace = preprocess(recording, PreprocessConfig(rate_hz=rate_hz, trim_ms=0, block_ms=SHORT_BLOCKS_MS[-1]))
        fit_scaling(trace, tuple(range(trace.n_blocks)))
    except ValueError as error:
        yield Finding(UNUSABLE, "refused", "", f"training refuses it: {error}")


def _report(name: str, channel: Channel, unit: str, speed_force: SpeedForce | None) -> ChannelReport:
    x = channel.samples
    about = name, unit, channel.rate_hz, channel.times_s is None, x.size, channel.duration_s
    size = float(x.min()), float(x.max()), float(x.mean()), rms(x)
    return ChannelReport(*about, *size, *one_channel.noise_floor(name, channel, speed_force))
