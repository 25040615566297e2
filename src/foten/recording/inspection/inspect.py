"""All checks of a recording, in one call."""

from __future__ import annotations

import numpy as np

from foten.recording.inspection.amplitude import check_clipping, check_spikes, check_units
from foten.recording.inspection.hand import Hand, check_contact, check_ranges, check_signs, coverage_of, hand_in
from foten.recording.inspection.noise import check_lines, check_noise, check_whiteness, density, noise_floor
from foten.recording.inspection.sampling import check_durations, check_gaps, check_missing, check_order, check_repeats
from foten.recording.inspection.values import PROBLEM, ChannelReport, Finding, Inspection
from foten.recording.recording import UNITS, Channel, Recording


def inspect_recording(recording: Recording) -> Inspection:
    """Return the numbers of each channel, findings, and the coverage of speed and force."""
    findings: list[Finding] = []
    hand = None
    try:
        hand = hand_in(recording)
    except ValueError as error:
        findings.append(Finding(PROBLEM, "refused", "", f"training refuses it: {error}"))
    reports = tuple(_report(name, channel, hand) for name, channel in recording.channels.items())
    findings += check_missing(recording)
    findings += check_durations(recording)
    for name, channel in recording.channels.items():
        findings += check_units(name, channel, recording)
        for check in (check_gaps, check_spikes, check_clipping, check_repeats):
            findings += check(name, channel)
    findings += check_order(recording)
    psd = {}
    for name, channel in recording.channels.items():
        if name.startswith("acceleration"):
            findings += check_whiteness(name, channel)
            if channel.samples.size >= 64:
                psd[name] = density(channel)
                findings += check_lines(name, *psd[name])
    findings += check_signs(recording)
    findings += check_contact(recording, hand)
    findings += check_noise(reports)
    coverage = None if hand is None else coverage_of(hand)
    if coverage is not None:
        findings += check_ranges(coverage)
    return Inspection(reports, tuple(findings), coverage, psd, recording.sha256())


def _report(name: str, channel: Channel, hand: Hand | None) -> ChannelReport:
    x = channel.samples
    low, high = np.quantile(x, [0.01, 0.99])
    floor, source = noise_floor(name, channel, hand)
    return ChannelReport(
        name=name,
        unit=UNITS[name],
        rate_hz=channel.rate_hz,
        regular=channel.times_s is None,
        n_samples=x.size,
        duration_s=channel.duration_s,
        minimum=float(x.min()),
        maximum=float(x.max()),
        low=float(low),
        high=float(high),
        mean=float(x.mean()),
        rms=float(np.sqrt(np.mean(x**2))),
        noise_floor=floor,
        noise_floor_from=source,
    )
