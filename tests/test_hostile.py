"""Whatever is in a file, a command does its work or refuses it in one line: no traceback, no crash, no hang."""

import json
import signal
import warnings
from pathlib import Path
from typing import Any

import pytest
from safetensors.numpy import save

from conftest import exported
from foten.baselines.sizes import TRAINABLE
from foten.cli.command_line import _status
from foten.models.texture_file import Texture
from hostile import Generator

N_ALWAYS, N_SLOW, BATCH = 60, 2000, 200
MAX_S = 60  # of one command, on a busy machine; without one, none takes 5


@pytest.fixture(scope="module")
def generator(texture: Texture, plain_texture: Texture, tmp_path_factory: pytest.TempPathFactory) -> Generator:
    local = exported("ar", TRAINABLE["ar"](n_models=9, n_triangles=8))
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


EVIL = "\x1b[2J\x1b]0;mine\x07\r\n\u202e\ud800" + "x" * 1_000_000


@pytest.mark.parametrize(
    ("fields", "arguments"),
    [
        ({"texture": EVIL, "licence": EVIL}, ["info"]),
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
