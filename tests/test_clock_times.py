"""Times of a clock as seconds."""

from datetime import datetime, time, timedelta

import numpy as np
import pytest

from foten.datasets.clock_times import clock_seconds


@pytest.mark.parametrize(
    ("texts", "seconds"),
    [
        (["00:01.5", "00:02.25"], [0, 0.75]),
        (["1:00:00.5", "", "1:00:01"], [0, np.nan, 0.5]),
        (["2026-05-01 12:00", "2026-05-01 12:01"], [0, 60]),  # hours and minutes
        (["11:59 am", "12:00 PM"], [0, 60]),
        (["12:00:00+02:00", "12:00:01+02:00"], [0, 1]),
        (["23:59:59.5", "00:00:00.25", "00:00:01"], [0, 0.75, 1.5]),  # past midnight
        (["11:59:59 AM", "12:00:00 PM", "1:00:00 pm"], [0, 1, 3601]),
        (["2026-02-28T23:59:59Z", "2026-03-01T00:00:01Z"], [0, 2]),
        (["1.5.2026 12:00:00,125", "1.5.2026 12:00:00,250"], [0, 0.125]),
        ([str(time(12, 0, 0, 500)), str(time(12, 0, 1))], [0, 0.9995]),  # as a workbook's cells
        ([str(datetime(2026, 5, 1, 12, 0, 0, 500)), str(datetime(2026, 5, 1, 12, 0, 1))], [0, 0.9995]),
        ([str(timedelta(seconds=1)), str(timedelta(seconds=2.5))], [0, 1.5]),
    ],
)
def test_times_count_from_the_first(texts: list[str], seconds: list[float]) -> None:
    np.testing.assert_allclose(clock_seconds(texts), seconds, atol=1e-9)


@pytest.mark.parametrize(
    "texts",
    [
        ["12:00", "noon"],
        ["", ""],
        ["1.5.2026 12:00:00", "2.5.2026 12:00:00"],
        ["1.5", "2"],
        ["12:61:00", "12:62:00"],
        ["13:00:00 PM", "13:00:01 PM"],
        ["2026-02-30 12:00:00", "2026-02-31 12:00:00"],
        ["2026-05-01 12:00:00", "12:00:01"],
        ["2026-10-25T02:59:59+02:00", "2026-10-25T02:00:00+01:00"],
    ],
)
def test_what_is_no_clock_stays_what_it_is(texts: list[str]) -> None:
    assert clock_seconds(texts) is None
