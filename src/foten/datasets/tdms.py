"""National Instruments TDMS files as columns, with the rates and units that they state."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

from foten.datasets.columns import Column
from foten.untrusted import brief, check_regular

_UNITS = ("unit_string", "NI_UnitDescription", "NI_Unit", "unit", "units", "Unit", "Units")
"""Properties in which programs state a channel's unit; LabVIEW's waveforms have the first."""


def read_tdms(path: Path) -> list[Column]:
    """Return the channels of a TDMS file: by their names, or `GROUP/CHANNEL` where two groups share a name.

    The rate is the waveform's (`wf_increment`), the unit the channel's (`unit_string` or the like).

    Raises:
        ValueError: empty, truncated, foreign.
    """
    check_regular(path)
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    log_manager.set_level(logging.CRITICAL)  # what it warns of is refused below, in one line
    try:
        file = TdmsFile.read(path)
    except Exception as error:  # a damaged file raises struct.error, UnicodeDecodeError, KeyError and others
        raise ValueError(f"{path.name} is truncated or is no TDMS file ({brief(error)})") from None
    status = file.file_status
    lengths = (status.channel_statuses or {}).values()
    if status.incomplete_final_segment or any(one.read_length < one.expected_length for one in lengths):
        raise ValueError(f"{path.name} is truncated: its last segment is incomplete")
    channels = [channel for group in file.groups() for channel in group.channels()]
    names = [channel.name for channel in channels]
    columns = []
    for channel in channels:
        name = channel.name if names.count(channel.name) == 1 else f"{channel.group_name}/{channel.name}"
        samples = np.asarray(channel[:])
        rate_hz = _rate(channel.properties.get("wf_increment"))
        unit = next((str(channel.properties[key]) for key in _UNITS if channel.properties.get(key)), "").strip()
        if samples.dtype.kind in "biuf":
            columns.append(Column(name, samples.astype(np.float64), rate_hz, unit))
        else:
            columns.append(Column(name, np.zeros(0), fault="holds text or times, expected numbers"))
    if not columns:
        raise ValueError(f"{path.name} holds no channel")
    return columns


def _rate(increment_s: Any) -> float | None:
    """Return the rate of a waveform [Hz]; none where the file states no step, or one that cannot be."""
    if not isinstance(increment_s, int | float | np.number) or not 1e-12 < increment_s < 1e12:
        return None
    rate = 1 / float(increment_s)
    # The increment is a rounded double: 1/(1/10000) need not be 10000.
    return float(round(rate)) if abs(rate - round(rate)) < 1e-9 * rate else rate
