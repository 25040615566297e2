"""Several takes of one surface: times, filters, blocks and windows never span two, and every stage names them."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from foten.datasets.hdf5 import load_recording, load_takes, write_recording
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.piecewise_ar.fit import _pieces
from foten.models.texture_file import read_texture
from foten.recording.inspection import inspect_recording
from foten.recording.preprocess import PreprocessConfig, fitting_cut, preprocess
from foten.recording.recording import Channel, Recording, joined_takes
from foten.recording.split import Split
from foten.simulation.simulate import simulate
from foten.training.job import scaled_blocks, shortest_block
from test_cli import foten

CONFIG = PreprocessConfig(trim_ms=0.0, block_ms=500.0)


def take(seed: int, seconds: float = 3.0, name: str = "") -> Recording:
    return dataclasses.replace(simulate("linear-twin", seconds, seed=seed), name=name)


@pytest.fixture
def takes() -> Recording:
    return joined_takes([take(1, 3.0, "a.csv"), take(2, 4.3, "b.csv"), take(3, 3.0, "c.csv")])


def test_blocks_are_those_of_each_take_by_itself(takes: Recording) -> None:
    """Filtered across a seam, the end of one take would ring into the next: a high-pass of 20 Hz for 50 ms."""
    trace = preprocess(takes, CONFIG)
    alone = [preprocess(one, CONFIG) for one in takes.takes]
    assert trace.take_blocks == tuple(one.n_blocks for one in alone) == (5, 8, 5)
    for name in ("acceleration", "speed", "force"):
        np.testing.assert_array_equal(getattr(trace, name), np.concatenate([getattr(one, name) for one in alone]))
    assert [i for i in range(trace.n_blocks) if not trace.follows(i)] == [0, 5, 13]
    assert trace.n_dropped == sum(one.n_dropped for one in alone) > 0
    assert trace.recording_sha256 == takes.sha256() not in {one.sha256() for one in takes.takes}


def test_pieces_of_local_models_end_where_a_take_ends() -> None:
    """Blocks 4 and 5 follow one another in the trace, and are hours apart."""
    parts = [take(1), take(2)]
    loud = dataclasses.replace(parts[1]["force"], samples=parts[1]["force"].samples + 3.0)  # which no piece may mix
    trace = preprocess(
        joined_takes([parts[0], dataclasses.replace(parts[1], channels={**parts[1].channels, "force": loud})]), CONFIG
    )
    split = Split(tuple(range(10)), (), (), 10, trace.block, "regrouped", 0)
    pieces = list(_pieces(scaled_blocks(trace, split)))
    assert len(pieces) >= 2
    for piece in pieces:
        assert piece[:, 2].max() < 3.0 or piece[:, 2].min() > 3.0


def test_takes_come_back_from_a_file(tmp_path: Path, takes: Recording) -> None:
    write_recording(takes, tmp_path / "whole.h5")
    back = load_recording(tmp_path / "whole.h5")
    assert back.sha256() == takes.sha256()
    assert [one.name for one in back.takes] == ["a.csv", "b.csv", "c.csv"]
    assert back.takes[1].history == takes.takes[1].history
    for one in takes.takes:
        write_recording(one, tmp_path / one.name.replace("csv", "h5"))
    assert load_takes([tmp_path / f"{name}.h5" for name in "abc"]).sha256() == takes.sha256()
    with h5py.File(tmp_path / "gap.h5", "w") as file, h5py.File(tmp_path / "whole.h5") as whole:
        file.attrs.update(whole.attrs)
        whole.copy("channels", file)
        whole.copy("takes/3", file, "takes/3")
    with pytest.raises(ValueError, match="takes are 3, expected 2, 3 and so on"):
        load_recording(tmp_path / "gap.h5")


def test_a_texture_is_named_as_all_its_takes_are(takes: Recording) -> None:
    named = [dataclasses.replace(one, texture=f"cork ({i})") for i, one in enumerate(takes.takes)]
    assert joined_takes(named).texture == "cork"
    assert joined_takes([named[0], dataclasses.replace(named[1], texture="wood")]).texture == "cork (0)"


def test_takes_that_do_not_belong_together_are_refused(takes: Recording) -> None:
    odd = Recording({"speed": Channel(np.ones(3000), 1000.0)}, name="d.csv")
    with pytest.raises(ValueError, match=r"take 4 \(d.csv\) has the channels speed, expected as the first: acc"):
        joined_takes([takes, odd])
    with pytest.raises(ValueError, match=r"take 4 \(b.csv\) repeats take 2"):
        joined_takes([takes, takes.takes[1]])
    with pytest.raises(ValueError, match="are in m/s² and relative units"):
        joined_takes([takes, dataclasses.replace(take(9), calibrated=False)])
    cut = {name: Channel(channel.samples[:300], 1000.0) for name, channel in take(2).channels.items()}
    short = joined_takes([take(1), Recording(cut, name="tap.csv")])
    with pytest.raises(ValueError, match=r"take 2 \(tap.csv\): 0.3 s are covered"):
        preprocess(short, CONFIG)


def test_an_inspection_is_of_all_takes_and_names_one(takes: Recording) -> None:
    first, *others = takes.takes
    samples = first["acceleration"].samples.copy()
    samples[1500] = 300.0
    spiky = dataclasses.replace(first, channels={**first.channels, "acceleration": Channel(samples, 1000.0)})
    inspection = inspect_recording(joined_takes([spiky, *others]))
    (acceleration,) = (report for report in inspection.channels if report.name == "acceleration")
    assert (acceleration.n_samples, acceleration.maximum) == (10_300, 300.0)
    assert inspection.takes_s == (3.0, 4.3, 3.0)
    assert any(re.match(r"take 1 \(a.csv\): .*spike", finding.text) for finding in inspection.problems)
    alone = [inspect_recording(one).coverage for one in takes.takes]
    assert inspection.coverage is not None
    assert inspection.coverage.seconds.sum() == pytest.approx(sum(one.seconds.sum() for one in alone if one))
    assert inspection.to_text().startswith("3 takes of 3 to 4.3 s\n")


def test_one_take_of_no_use_is_left_out_and_spoils_no_other(takes: Recording) -> None:
    still = {**take(5).channels, "speed": Channel(np.zeros(3000), 1000.0)}
    inspection = inspect_recording(joined_takes([takes, Recording(still, name="still.csv")]))
    assert any("leave this take out" in finding.text for finding in inspection.problems)
    assert inspection.to_dict()["usable"]
    cut = [{name: Channel(of.samples[:150], 1000.0) for name, of in take(i).channels.items()} for i in range(2)]
    short = [Recording(channels, name=f"{i}.csv") for i, channels in enumerate(cut)]
    assert inspect_recording(joined_takes(short)).verdict.startswith("record again: 2 takes hold 2 blocks")


def test_blocks_hold_the_windows_of_the_model() -> None:
    """A training refuses what is shorter: recordings of 4.3 s were cut into blocks of 100 ms, and refused."""
    rate_hz, short = PreprocessConfig().rate_hz, take(1, 4.3)
    needed = 1000 * shortest_block(FotenPlusSizes().window) / rate_hz
    assert fitting_cut(short)[1] >= needed
    assert fitting_cut(short, 100.0) == (0.0, 100.0)
    assert fitting_cut(take(1, 20.0), 1360.0) == (0.0, 2000.0)  # as the GAN's windows need
    assert fitting_cut(take(1, 20.0), 3000.0) == (0.0, 2000.0)  # which is refused, for the longest is too short


def test_a_tap_beside_strokes_does_not_cut_their_blocks_short(takes: Recording) -> None:
    tap = joined_takes([take(6, 20.0), take(7, 20.0), take(8, 1.0)])
    assert fitting_cut(tap) == fitting_cut(joined_takes(tap.takes[:2])) == (0.0, 1000.0)


@pytest.mark.parametrize(
    ("seconds", "n", "fits"),
    [
        (60.0, 1, (2000.0, 2000.0)),  # the defaults
        (40.0, 1, (2000.0, 1000.0)),  # of which three blocks would judge it
        (20.0, 1, (0.0, 500.0)),
        (5.0, 1, (0.0, 200.0)),  # few strokes
        (3.0, 1, (2000.0, 2000.0)),  # refused with options
        (20.0, 4, (0.0, 2000.0)),
        (8.0, 4, (0.0, 1000.0)),
        (5.0, 6, (0.0, 500.0)),
        (0.5, 60, (0.0, 200.0)),  # the shortest that holds five windows
    ],
)
def test_blocks_fit_the_recording_and_its_takes(seconds: float, n: int, fits: tuple[float, float]) -> None:
    def steady(value: float) -> Recording:
        samples = np.full(round(1000 * seconds), value)
        return Recording({name: Channel(samples, 1000.0) for name in ("acceleration", "speed", "force")})

    assert fitting_cut(joined_takes([steady(1.0 + i) for i in range(n)])) == fits


def test_the_commands_take_several_files_and_append(tmp_path: Path, takes: Recording) -> None:
    paths = [str(tmp_path / one.name.replace("csv", "h5")) for one in takes.takes]
    for one, path in zip(takes.takes, paths, strict=True):
        write_recording(one, Path(path))
    texture = str(tmp_path / "t.foten")
    train = ["train", *paths, "-o", texture, "--epochs", "0", "--threads", "1"]
    assert "3 takes, 9.8 s in 49 blocks of 200 ms, with nothing trimmed at the ends" in foten(*train)[0]
    assert [one["name"] for one in read_texture(texture).card["takes"]] == ["a.csv", "b.csv", "c.csv"]
    assert "takes         3 (a.csv, b.csv, c.csv), 10.3 s" in foten("info", texture)[0]
    assert json.loads(foten("evaluate", texture, *paths, "--json")[0])["split"] == "regrouped"
    foten(*train, "--block", "300")
    assert read_texture(texture).card["preprocess"]["trim_ms"] == 0  # as without --block
    for some in (paths[:2], paths[::-1], paths[1:2]):  # blocks that it learned from would count as unheard
        said = foten("evaluate", texture, *some, status=2)[1]
        assert "some of it was trained on and some not, or in another order" in said
    table = tmp_path / "d.csv"
    rng = np.random.default_rng(0)
    rows = "".join(f"{i / 1000},{a:.6f},{80 + i / 100:.2f},1\n" for i, a in enumerate(rng.standard_normal(2000)))
    table.write_text(f"t,acceleration,speed,force\n{rows}")
    whole = str(tmp_path / "whole.h5")
    foten("import", table, "-o", whole)
    append = ["import", str(table), "-o", whole, "--append"]
    assert "take 2 (d.csv) repeats take 1" in foten(*append, status=2)[1]
    assert "--texture comes from the recording that is extended" in foten(*append, "--texture", "jeans", status=2)[1]
    table.write_text(f"t,acceleration,speed,force\n{rows.replace(',1', ',2')}")
    foten(*append)
    assert [one.name for one in load_recording(Path(whole)).takes] == ["d.csv", "d.csv"]
    said = foten("render", texture, "--recording", whole, "-o", tmp_path / "o.csv")[1]
    assert "the recording has 2 takes: the stroke of the first is used (d.csv)" in said
