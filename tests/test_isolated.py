"""Files that crash, outgrow or lead out of their library: refused in a sentence."""

import os
import re
import sys
import threading
import zipfile
from contextlib import nullcontext
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pytest
from PIL import Image
from scipy.io import savemat

from foten.cli.command_line import _status
from foten.console import preload
from foten.datasets import isolated
from foten.datasets.binary import read_hdf5
from foten.datasets.columns import Column
from foten.datasets.hatt import read_models
from foten.datasets.hdf5 import load_recording, write_recording
from foten.datasets.importing import DATASETS, read_columns
from foten.datasets.isolated import contents_of, read_isolated
from foten.editing.texture_library import open_library
from foten.models.texture_file import Texture, read_texture, write_texture
from foten.recording.recording import Channel, Recording
from foten.runtime.actuator import read_profile
from foten.runtime.renderer import Renderer
from foten.untrusted import check_numbers, max_content, parse_json, parse_toml, read_whole, shown, too_much
from foten_lab.experiment import read_experiment
from foten_study.design import read_design

FORCE = np.linspace(0, 3, 400)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Small recording of ours."""
    path = tmp_path / "a.h5"
    write_recording(Recording({"force": Channel(FORCE, 100.0)}), path)
    return path


def _crashing_files(folder: Path) -> dict[str, str]:
    """Write a reader that dies as HDF5 does on some damaged files; return its names."""
    (folder / "dying.py").write_text(
        "import os, signal, time\n"
        "def crashes(path): os.kill(os.getpid(), signal.SIGSEGV)\n"
        "def loops(path):\n    while True: pass\n"
        "def grows(path): return None, [bytearray(1 << 30)]\n"
        "def raises(path): raise RuntimeError('Unspecified error\\nin ' + 9999 * 'x')\n"
    )
    return {name: f"dying.{name}" for name in ("crashes", "loops", "grows", "raises")}


def test_a_library_that_dies_is_a_sentence(tmp_path: Path, recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    readers = _crashing_files(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    start = (
        f"import sys; sys.path[:] = {sys.path!r}; from foten.datasets import isolated; "
        f"isolated.READERS.update({readers!r}); isolated.answer(*sys.argv[1:])"
    )
    monkeypatch.setattr(isolated, "_START", start.replace("{", "{{").replace("}", "}}"))
    monkeypatch.setattr(isolated, "MAX_CPU_S", 1)
    for kind, message in {
        "crashes": r"a.h5 is truncated, damaged or no crashes file \(its library crashes on it\)",
        "loops": "more than 1 s of processor time; FOTEN_MAX_MB=10000 gives it longer",
        "grows": "more than its size is worth; FOTEN_MAX_MB=6[0-9]{2} raises it",
        "raises": r"Unspecified error in x{100}",
    }.items():
        with pytest.raises(ValueError, match=message) as refusal:
            read_isolated(kind, recording)
        assert len(str(refusal.value)) < 320


N_BOMB = 9_000_000  # samples: 72 MB, of next to nothing


def _hdf5_bomb(path: Path, places: str = "acceleration speed force", **attributes: object) -> None:
    """Datasets that were never written."""
    with h5py.File(path, "w", userblock_size=512 if path.suffix == ".mat" else 0) as file:
        for place in places.split():
            dataset = file.create_dataset(place, shape=(N_BOMB,), dtype="i1", chunks=(100_000,))
            dataset.attrs.update({"rate_hz": 1e4, "unit": "N", "MATLAB_class": np.bytes_("int8")})
        file.attrs.update(attributes)
    if path.suffix == ".mat":
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def _deep_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["/".join(["g"] * 1500) + "/force"] = FORCE


def _workbook(path: Path, before: bytes, after: bytes, n_spaces: int) -> None:
    """A workbook whose sheet is padded with spaces."""
    openpyxl.Workbook().save(path)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in parts.items():
            is_sheet = name == "xl/worksheets/sheet1.xml"
            padded = data.replace(b"<sheetData", before + b" " * n_spaces + after + b"<sheetData", 1)
            archive.writestr(name, padded if is_sheet else data)


BOMBS = {
    "ours.h5": lambda path: _hdf5_bomb(path, "channels/force", format="foten-recording", version=1),
    "foreign.h5": _hdf5_bomb,
    "deep.h5": _deep_hdf5,
    "v7.mat": _hdf5_bomb,
    "v5.mat": lambda path: savemat(path, {"force": np.zeros(N_BOMB, np.int8)}, do_compression=True),
    "zeros.npz": lambda path: np.savez_compressed(path, force=np.zeros(N_BOMB, np.int8)),
    "fields.npz": lambda at: np.savez_compressed(at, force=np.zeros(N_BOMB // 3, [("a", "i1", 3), ("b", "i1, i1")])),
    "words.npz": lambda path: np.savez_compressed(path, force=np.zeros(N_BOMB // 50, "U100")),
    "spaces.xlsx": lambda path: _workbook(path, b"", b"", 80_000_000),
    "tag.xlsx": lambda path: _workbook(path, b"<sheetPr", b"/>", 60_000_000),  # whose parser reads it again and again
    "blank.csv": lambda path: path.write_text("a,b\n1,2\n" + 1_100_000 * "\n" + "1,2\n"),
    "sparse.h5": lambda path: (h5py.File(path, "w").close(), os.truncate(path, 20_000_000_000)),
    "sparse.wav": lambda path: os.truncate(path, 2_000_000_000) if path.touch() is None else None,
    "colours.png": lambda path: Image.new("RGB", (4100, 4100)).save(path),
}


@pytest.mark.parametrize("name", BOMBS)
def test_what_fills_memory_or_time_is_refused_before_the_work(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    BOMBS[name](path := tmp_path / name)
    arguments = ["inspect", str(path)] if name == "ours.h5" else ["import", str(path), "-o", str(tmp_path / "out.h5")]
    arguments = ["imagine", str(path), "--scale", "0.05", "--photo"] if name == "colours.png" else arguments
    monkeypatch.setattr(isolated, "MAX_CPU_S", 2)
    before = sum(os.times()[:4])  # seconds of this process and of those that it waited for
    assert _status(arguments) == 2
    assert sum(os.times()[:4]) - before < 10
    line = capfd.readouterr().err
    assert line.startswith(f"foten: {name}")
    assert line.count("\n") == 1
    assert re.search("FOTEN_MAX_MB=|32 groups in one another|take the blank ones out", line), line


@pytest.mark.parametrize("name", ["foreign.h5", "v7.mat", "zeros.npz"])
def test_a_bound_of_content_can_be_raised(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    BOMBS[name](tmp_path / name)
    monkeypatch.setenv("FOTEN_MAX_MB", "250")
    assert {column.samples.size for column in read_columns(tmp_path / name)} == {N_BOMB}
    monkeypatch.setenv("FOTEN_MAX_MB", "much")
    with pytest.raises(ValueError, match=r"FOTEN_MAX_MB is 'much', expected a whole number of MB"):
        read_columns(tmp_path / name)


@pytest.mark.parametrize(
    "lie",
    [
        lambda file: file.create_dataset("odd", shape=(10**12,), dtype="f8", chunks=(1000,)),
        lambda file: file.create_dataset("odd", shape=(500,), dtype="f8", external=[("/etc/hostname", 0, 4000)]),
        lambda file: file.__setitem__("odd", h5py.ExternalLink("/etc/hostname", "/")),
        lambda file: file.__setitem__("odd", h5py.SoftLink("/force")),
    ],
    ids=["of 10^12 samples", "samples in any file", "a link to any file", "a link"],
)
def test_what_lies_elsewhere_or_nowhere_is_not_read(tmp_path: Path, lie) -> None:
    path = tmp_path / "foreign.h5"
    with h5py.File(path, "w") as file:
        file["force"] = FORCE
        lie(file)
    columns = {column.name: column for column in read_hdf5(path)}
    np.testing.assert_array_equal(columns["force"].samples, FORCE)
    assert "odd" not in columns or (columns["odd"].fault and not columns["odd"].samples.size)


def test_a_recording_that_leads_elsewhere_is_refused(tmp_path: Path, recording: Path) -> None:
    (tmp_path / "secret").write_bytes(FORCE.tobytes())
    with h5py.File(recording, "r+") as file:
        attributes = dict(file["channels/force"].attrs)
        del file["channels/force"]
        storage = [(str(tmp_path / "secret"), 0, 8 * FORCE.size)]
        file.create_dataset("channels/force", shape=FORCE.shape, dtype="f8", external=storage).attrs.update(attributes)
    with pytest.raises(ValueError, match="channel force: keeps its samples in another place, which is not opened"):
        load_recording(recording)


def test_groups_that_hold_each_other_end(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["force"] = FORCE
        inner = file.create_group("a/b")
        inner["top"], inner["again"] = file["/"], file["force"]
    assert [column.name for column in read_hdf5(tmp_path / "a.h5")] == ["a/b/again"]


def test_a_file_is_read_up_to_its_bound_and_beyond_where_that_is_raised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (path := tmp_path / "a").touch()
    for size, expected in ((1 << 27, None), ((1 << 27) + 1, r"134.2 at most; FOTEN_MAX_MB=135 reads")):
        os.truncate(path, size)
        with pytest.raises(ValueError, match=expected) if expected else nullcontext():
            assert len(read_whole(path)) == size
    with pytest.raises(ValueError, match="is a folder"):
        read_whole(tmp_path)
    os.truncate(path, 2_500_000)
    assert max_content(path) == (64 << 20) + 32 * 2_500_000
    for raised, is_read in (("2", False), ("3", True), ("123456789", True)):
        monkeypatch.setenv("FOTEN_MAX_MB", raised)
        with nullcontext() if is_read else pytest.raises(ValueError, match=r"has 2\.5 MB"):
            read_whole(path, 1000)
    assert too_much(800_000_000, 64_000_000).endswith("FOTEN_MAX_MB=801 reads it all the same")


def test_rows_of_columns_are_told_by_their_ends() -> None:
    columns = [Column("a", np.zeros(3), row_numbers=range(2, 5)), Column("b", np.zeros(2))]
    assert [rows for rows, _ in contents_of(columns)[0]] == [[2, 5], [0, 0]]
    assert [column.n_rows for column in columns] == [3, 2]


def test_what_is_deep_long_or_large_is_refused_from_its_bound_on() -> None:
    assert parse_json("[" * 64 + "]" * 64)
    with pytest.raises(ValueError, match="nested more than 64 deep"):
        parse_json("[" * 65 + "]" * 65)
    assert shown("x" * 2000) == "x" * 2000
    assert shown("x" * 2001) == "x" * 2000 + " …"
    assert parse_toml("#" * 100_000) == {}
    with pytest.raises(ValueError, match="it has 100,001 characters, expected 100,000 at most"):
        parse_toml("#" * 100_001)
    check_numbers(2**63 - 1, "a")
    with pytest.raises(ValueError, match="a holds a number"):
        check_numbers([-(2**63)], "a")


def test_a_pipe_is_no_file(tmp_path: Path) -> None:
    readers = {**dict.fromkeys(DATASETS, read_columns), ".xml": read_models, ".foten": read_texture}
    for suffix, reader in readers.items():
        os.mkfifo(tmp_path / f"a{suffix}")
        with pytest.raises(ValueError, match="is a pipe or a device, expected a file"):
            reader(tmp_path / f"a{suffix}")


FILES = {"134.2": [read_texture, Renderer], "16.8": [open_library, read_profile], "0.4": [read_experiment, read_design]}


@pytest.mark.parametrize(("most", "reads"), [*FILES.items(), ("2.0", [read_models])])
def test_a_file_is_not_read_where_its_kind_is_never_as_large(tmp_path: Path, most: str, reads) -> None:
    (tmp_path / "library.json").touch()
    os.truncate(tmp_path / "library.json", 20 << 30)
    for read in reads:
        with pytest.raises(ValueError, match=rf"library.json has 21,474.8 MB, expected {most} at most"):
            read(tmp_path if read is open_library else tmp_path / "library.json")


def test_a_missing_library_is_named(recording: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys) -> None:
    Image.new("L", (64, 64)).save(tmp_path / "map.png")
    for name in ("h5py", "PIL"):
        (tmp_path / f"{name}.py").write_text(f"raise ModuleNotFoundError('no {name}', name='{name}')")
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(tmp_path)
    assert _status(["inspect", str(recording)]) == 2
    assert "this needs h5py, which is not installed: pip install './packages/foten[data]'" in capsys.readouterr().err
    assert _status(["imagine", str(tmp_path / "map.png"), "--scale", "0.05", "--photo"]) == 2
    assert "this needs PIL, which is not installed: pip install './packages/foten[data]'" in capsys.readouterr().err


def test_libraries_are_imported_beside_the_reading_of_files_that_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is missing is left to who needs it: no thread prints a traceback before the line that says so."""
    (tmp_path / "beside.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    failed: list[object] = []
    monkeypatch.setattr(threading, "excepthook", failed.append)
    for files in ([tmp_path / "missing.h5"], [tmp_path / "beside.py"]):
        assert "beside" not in sys.modules
        before = threading.enumerate()
        preload(["no_such_library", "beside"], files)
        for thread in set(threading.enumerate()) - set(before):
            thread.join()
    assert "beside" in sys.modules
    assert not failed


def test_a_loop_of_links_as_output_is_one_line_or_replaced(
    texture: Texture, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_texture(texture, tmp_path / "t.foten")
    (tmp_path / "loop.wav").symlink_to(tmp_path / "loop.wav")
    (tmp_path / "folder").symlink_to(tmp_path / "folder")
    stroke = ["--speed", "50", "--force", "1", "--seconds", "0.1"]
    assert _status(["render", str(tmp_path / "t.foten"), *stroke, "-o", str(tmp_path / "loop.wav")]) == 0
    assert (tmp_path / "loop.wav").stat().st_size > 100
    capsys.readouterr()
    assert _status(["render", str(tmp_path / "t.foten"), *stroke, "-o", str(tmp_path / "folder" / "a.wav")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert _status(["info", str(tmp_path / "folder")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
