"""Whatever is in a file, a command does its work or refuses it in one line: no traceback, no crash, no hang."""

import json
import os
import signal
import struct
import warnings
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from safetensors.numpy import save

from conftest import exported
from foten.cli.command_line import _status
from foten.models.texture_file import Texture
from foten.models.trainable import TRAINABLE
from hostile import DEEP, Generator

N_ALWAYS, N_SLOW, BATCH = 60, 2000, 200
MAX_S = 60  # of one command, on a busy machine; without one, none takes 5


@pytest.fixture(scope="module")
def generator(texture: Texture, plain_texture: Texture, tmp_path_factory: pytest.TempPathFactory) -> Generator:
    local = exported("ar", TRAINABLE["ar"].sizes(n_models=9, n_triangles=8))
    return Generator([texture, plain_texture, local], tmp_path_factory.mktemp("valid"))


class HungError(BaseException):
    """A command took more than `MAX_S`."""


def _hung(*_: object) -> None:
    raise HungError


def _check(generator: Generator, numbers: range, folder: Path, capfd: pytest.CaptureFixture[str]) -> set[int]:
    """Exit statuses of the commands, each of which did its work, or refused its file in one line that a terminal may show.

    Above it may stand what was noted of the file.
    """
    statuses = set()
    signal.signal(signal.SIGALRM, _hung)
    for arguments in [command for number in numbers for command in generator.write(number, folder)[1]]:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            signal.alarm(MAX_S)
            status = _status(arguments)
            signal.alarm(0)
        out, err = capfd.readouterr()
        what = f"foten {' '.join(arguments)}: exit {status}\n{err[-1500:]}"
        assert not warned, what
        assert (out + err).replace("\n", "").isprintable(), what
        refused = [line.startswith("foten: ") for line in err.splitlines()]
        judged = status == 1 and arguments[0] == "inspect" and "record again: " in out
        assert status == 0 or judged or (status == 2 and sum(refused) == 1 and refused[-1] and err[-1] == "\n"), what
        statuses.add(status)
    return statuses


def test_hostile_files_are_refused_in_one_line(
    generator: Generator, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert _check(generator, range(N_ALWAYS), tmp_path, capfd) == {0, 2}  # some are damaged where it does not matter


@pytest.mark.slow
@pytest.mark.parametrize("first", range(N_ALWAYS, N_SLOW, BATCH))
def test_more_hostile_files_are_refused_in_one_line(
    generator: Generator, tmp_path: Path, first: int, capfd: pytest.CaptureFixture[str]
) -> None:
    _check(generator, range(first, min(first + BATCH, N_SLOW)), tmp_path, capfd)


EVIL = "\x1b[2J\x1b]0;mine\x07\r\nproof: forged\u202e\ud800" + "x" * 1_000_000


@pytest.mark.parametrize(
    ("fields", "arguments"),
    [
        ({"texture": EVIL, "licence": EVIL, "takes": [{"name": EVIL, "seconds": 1, "blocks": 1}]}, ["info"]),
        ({"texture": EVIL}, ["play", "--to", "null", "--seconds", "0.02"]),
        ({"texture": EVIL}, ["export", "--to", "c", "-o", "t.h"]),
        ({"units": {"acceleration": EVIL, "speed": "mm/s", "force": "N"}}, ["info"]),
        ({"licence": [EVIL]}, ["info"]),
        ({"model": EVIL}, ["info"]),
    ],
)
def test_what_a_card_says_reaches_a_terminal_printable_and_short(
    texture: Texture,
    fields: dict[str, Any],
    arguments: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """It came raw: escapes that a terminal obeys, and a million characters."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "t.foten"
    path.write_bytes(save(dict(texture.tensors), metadata={"foten": json.dumps({**texture.card, **fields})}))
    status = _status([*arguments, str(path)])
    out, err = capsys.readouterr()
    assert status == (0 if "texture" in fields else 2)
    assert out + err
    for line in (out + err).split("\n"):
        assert line.isprintable()
        assert len(line) < 2100
        assert not line.startswith("proof: forged")


def test_every_refusal_of_a_texture_names_its_file(
    texture: Texture, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those of the kernel did not: it is given bytes."""
    n_refused = 0
    for name, tensor in texture.tensors.items():
        (tmp_path / "t.foten").write_bytes(Texture(texture.card, {**texture.tensors, name: -tensor - 1}).to_bytes())
        if _status(["info", str(tmp_path / "t.foten")]) == 2:
            n_refused += 1
            assert capsys.readouterr().err.startswith("foten: t.foten: ")
    assert n_refused > 10


def _wav(n_channels: int, end: int) -> bytes:
    form = struct.pack("<4sIHHIIHH", b"fmt ", 16, 1, n_channels, 8000, 16_000, 2, 16)
    return (b"RIFF" + struct.pack("<I", end - 8) + b"WAVE" + form + struct.pack("<4sI", b"data", 8) + bytes(8))[:end]


def _tiff(path: Path) -> None:
    Image.new("L", (64, 64), 7).save(path, compression="tiff_lzw")
    path.write_bytes(path.read_bytes()[:-200])


@pytest.mark.parametrize(
    ("name", "write", "arguments", "match"),
    [
        *(
            (name, text.encode(), arguments, "it is nested more than 64 deep")
            for name, text in (("deep.toml", "x = " + "[" * (DEEP - 4)), ("dots.toml", "a" + ".a" * 1000 + " = 1"))
            for arguments in (["sweep", "--dry-run"], ["study", "check"])
        ),
        ("a.toml", b"a." * DEEP + b"a = 1", ["sweep", "--dry-run"], "(it has 200,005 characters, expected"),
        ("a.toml", os.mkfifo, ["sweep", "--dry-run"], "is a pipe or a device"),
        ("a.csv", os.mkfifo, ["tables"], "is a pipe or a device"),
        ("results", lambda path: (path.mkdir(), os.mkfifo(path / "a.json")), ["tables"], "a.json is no result"),
        ("a.png", os.mkfifo, ["imagine", "--scale", "0.05", "--photo"], "is a pipe or a device"),
        ("a.foten", os.mkfifo, ["bench"], "is a pipe or a device"),
        ("a.xml", os.mkfifo, ["import", "-o", "{}/o.foten"], "is a pipe or a device"),
        ("a.csv", lambda path: path.symlink_to(path), ["import", "-o", "{}/o.h5"], "no such file: "),
        ("a.wav", _wav(1, 36), ["import", "-o", "{}/o.h5"], "a.wav is truncated or is no WAV file (its parts"),
        ("a.wav", _wav(0, 52), ["import", "-o", "{}/o.h5"], "a.wav is truncated or is no WAV file (its parts"),
        ("a.tif", _tiff, ["imagine", "--scale", "0.05", "--photo"], "a.tif is truncated or is no picture"),
        (
            "a.png",
            lambda path: Image.new("L", (64, 64)).save(path),
            ["imagine", "--scale", "1", "-o", "{}/o.foten"],
            "a.png: ",
        ),
    ],
)
def test_what_hung_or_was_no_line_is_one(
    name: str, write: Any, arguments: list[str], match: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(write) if isinstance(write, bytes) else write(path)
    signal.signal(signal.SIGALRM, _hung)
    signal.alarm(MAX_S)
    status = _status([*(word.format(tmp_path) for word in arguments), str(path)])
    signal.alarm(0)
    err = capfd.readouterr().err
    assert status == 2
    assert match in err
    assert err.startswith("foten: ")
    assert err.count("\n") == 1
