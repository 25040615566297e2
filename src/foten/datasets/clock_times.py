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
    r"(?P<first>\d+):(?P<second>[0-5]\d(?:[.,]\d+)?)(?::(?P<third>[0-5]\d(?:[.,]\d+)?))?"
    r"\s*(?P<half>[AaPp][Mm])?\s*(?P<zone>Z|[+-]\d\d:?\d\d)?"
)


def clock_seconds(texts: Sequence[str]) -> Array | None:
    """Seconds from the first of some times of a clock, shape (n,), NaN where one is blank; None where they are something else.

    Three fields are hours, minutes and seconds; two, hours and minutes beside a date or AM and PM, else minutes and seconds.
    Without a date the clock may pass midnight once a day. A time zone, and a date not written as `2026-05-01`, whose day and
    month cannot be told apart, have to be the same throughout.
    """
    seconds, days = np.full(len(texts), np.nan), np.zeros(len(texts))
    dates, zones = set[str | None](), set[str | None]()
    for i, text in enumerate(texts):
        match = _CLOCK.fullmatch(text.strip())
        if match is None:
            if text.strip():
                return None
            continue
        fields = [float(field.replace(",", ".")) for field in match.group("first", "second", "third") if field]
        if match["half"]:
            if not 1 <= fields[0] <= 12:
                return None
            fields[0] = fields[0] % 12 + 12 * (match["half"][0] in "Pp")
        if len(fields) == 2 and (match["date"] or match["half"]):
            fields.append(0.0)
        seconds[i] = sum(field * 60**power for power, field in enumerate(reversed(fields)))
        dates.add(match["date"])
        zones.add(match["zone"])
        if match["date"]:
            try:
                days[i] = date.fromisoformat(match["date"]).toordinal()
            except ValueError:
                days[i] = np.nan
    known = np.flatnonzero(~np.isnan(seconds))
    if not known.size or len(zones) > 1:
        return None
    of_day = seconds[known]
    if dates == {None}:
        days[known] = np.cumsum(np.diff(of_day, prepend=of_day[0]) < -0.5 * DAY_S)
    elif len(dates) == 1:
        days[known] = 0.0
    if np.isnan(days[known]).any() or (None in dates and len(dates) > 1):
        return None
    return seconds - of_day[0] + DAY_S * (days - days[known[0]])
