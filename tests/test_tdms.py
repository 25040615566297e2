"""NI TDMS: rates and units come from the file."""

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter

from foten.datasets.binary import read_tdms

ACC = np.random.default_rng(0).standard_normal(400)
FORCE = np.linspace(0, 2, 40)


def _write(path):
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("fast", "acc", ACC, {"wf_increment": 1e-4, "unit_string": "g"}),
                ChannelObject("fast", "force", np.repeat(FORCE, 10), {"wf_increment": 1e-4}),
                ChannelObject("slow", "force", FORCE, {"wf_increment": 1 / 3000, "unit_string": "N"}),
            ]
        )


def test_channels_with_their_rates_and_units(tmp_path):
    _write(tmp_path / "a.tdms")
    columns = {column.name: column for column in read_tdms(tmp_path / "a.tdms")}
    assert list(columns) == ["acc", "fast/force", "slow/force"]
    np.testing.assert_array_equal(columns["acc"].samples, ACC)
    assert (columns["acc"].rate_hz, columns["acc"].unit) == (10_000, "g")
    assert (columns["slow/force"].rate_hz, columns["slow/force"].unit) == (3000, "N")


def test_truncated_and_foreign_files_are_refused(tmp_path):
    _write(tmp_path / "a.tdms")
    data = (tmp_path / "a.tdms").read_bytes()
    contents = {"late": data[:-100], "early": data[:60], "text": b"time,force\n0,1\n" * 20, "none": b""}
    for name, content in contents.items():
        (tmp_path / f"{name}.tdms").write_bytes(content)
        with pytest.raises(ValueError, match=f"{name}.tdms (is (truncated|empty)|holds no channel)"):
            read_tdms(tmp_path / f"{name}.tdms")
