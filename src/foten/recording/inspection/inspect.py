"""All checks of a recording, in one call."""

from __future__ import annotations

import numpy as np

from foten.dsp import perception
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
from foten.recording.inspection.values import UNUSABLE, ChannelReport, Finding, Inspection
from foten.recording.preprocess import PreprocessConfig, fitting_options
from foten.recording.recording import Channel, Recording, common_span_s


def inspect_recording(recording: Recording) -> Inspection:
    """Numbers of each channel, findings, and the coverage of speed and force."""
    findings: list[Finding] = []
    speed_force = None
    try:
        speed_force = speed_force_of(recording)
    except ValueError as error:
        findings.append(Finding(UNUSABLE, "refused", "", f"training refuses it: {error}"))
    named = recording.channels.items()
    reports = tuple(_report(name, channel, recording.unit(name), speed_force) for name, channel in named)
    findings += sampling.check_missing(recording)
    findings += sampling.check_durations(recording)
    for name, channel in named:
        findings += one_channel.check_units(name, channel, recording)
        of_channel = (sampling.check_gaps, one_channel.check_spikes, one_channel.check_clipping, sampling.check_repeats)
        findings += [finding for check in of_channel for finding in check(name, channel)]
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
    if end_s - start_s < PreprocessConfig().shortest_s:
        options = fitting_options(end_s - start_s, rate_hz, captured_hz)
    findings += sampling.check_short(end_s - start_s, options)
    return Inspection(reports, tuple(findings), coverage, psd, shares, options, recording.sha256())


def _report(name: str, channel: Channel, unit: str, speed_force: SpeedForce | None) -> ChannelReport:
    x = channel.samples
    about = name, unit, channel.rate_hz, channel.times_s is None, x.size, channel.duration_s
    rms = float(np.sqrt(np.mean(x**2)))
    size = float(x.min()), float(x.max()), float(x.mean()), rms
    return ChannelReport(*about, *size, *one_channel.noise_floor(name, channel, speed_force))
