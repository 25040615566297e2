"""Times of a clock, as `12:03:07.125` or `2026-05-01T12:03:07.125Z`, as seconds from the first."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date

import numpy as np

from foten.dsp import Array

DAY_S = 86400.0
_CLOCK = re.compile(
    r"(?:(?P<date>\d{4}-\d\d-\d\d|\d{1,2}[./]\d{1,2}[./]\d{4})[T ]\s*)?"
    r"(?P<first>\d+):(?P<second>\d\d(?:[.,]\d+)?)(?::(?P<third>\d\d(?:[.,]\d+)?))?"
    r"\s*(?P<half>[AaPp][Mm])?(?:Z|[+-]\d\d:?\d\d)?"
)


def clock_seconds(texts: Sequence[str]) -> Array | None:
    """Seconds from the first of some times of a clock, shape (n,), NaN where one is blank; None where they are something else.

    Two fields are minutes and seconds, three are hours, minutes and seconds. Without a date the clock may pass midnight once a
    day; a date that is not written as `2026-05-01` has to be the same throughout, since its day and month cannot be told apart.
    """
    seconds, days, dates = np.full(len(texts), np.nan), np.zeros(len(texts)), set()
    for i, text in enumerate(texts):
        match = _CLOCK.fullmatch(text.strip())
        if match is None:
            if text.strip():
                return None
            continue
        fields = [float(field.replace(",", ".")) for field in match.group("first", "second", "third") if field]
        if match["half"]:
            fields[0] = fields[0] % 12 + 12 * (match["half"][0] in "Pp")
        seconds[i] = sum(field * 60**power for power, field in enumerate(reversed(fields)))
        if match["date"]:
            dates.add(match["date"])
            try:
                days[i] = date.fromisoformat(match["date"]).toordinal()
            except ValueError:
                if len(dates) > 1:
                    return None
    known = np.flatnonzero(~np.isnan(seconds))
    if not known.size:
        return None
    of_day = seconds[known]
    if not dates:
        days[known] = np.cumsum(np.diff(of_day, prepend=of_day[0]) < -0.5 * DAY_S)
    return seconds - of_day[0] + DAY_S * (days - days[known[0]])
