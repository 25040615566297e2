"""Whatever is in a file, a command does its work or refuses it in one line: no traceback, no crash, no hang."""

import json
from pathlib import Path
from typing import Any

import pytest
from safetensors.numpy import save

from conftest import exported
from foten.baselines.sizes import TRAINABLE
from foten.cli.command_line import _status
from foten.models.texture_file import Texture
from hostile import KINDS, Generator, run_commands, run_hostile

N_ALWAYS, N_SLOW, BATCH = 60, 2000, 200


@pytest.fixture(scope="module")
def generator(texture: Texture, plain_texture: Texture, tmp_path_factory: pytest.TempPathFactory) -> Generator:
    local = exported("ar", TRAINABLE["ar"](n_models=9, n_triangles=8))
    return Generator([texture, plain_texture, local], tmp_path_factory.mktemp("valid"))


def _check(generator: Generator, numbers: range, folder: Path) -> list[int | None]:
    results = run_hostile(generator, numbers, folder)
    bad = [str(result) for result in results if not result.clean]
    assert not bad, f"{len(bad)} of {len(results)} commands:\n" + "\n".join(bad[:5])
    return [result.status for result in results]


def test_hostile_files_are_refused_in_one_line(generator: Generator, tmp_path: Path) -> None:
    statuses = _check(generator, range(N_ALWAYS), tmp_path)
    assert {0, 2} == set(statuses)  # some are damaged where it does not matter


@pytest.mark.slow
@pytest.mark.parametrize("first", range(N_ALWAYS, N_SLOW, BATCH))
def test_more_hostile_files_are_refused_in_one_line(generator: Generator, tmp_path: Path, first: int) -> None:
    _check(generator, range(first, min(first + BATCH, N_SLOW)), tmp_path)


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


def test_the_same_number_gives_the_same_file(generator: Generator, tmp_path: Path) -> None:
    for number in range(2 * len(KINDS)):
        path, _ = generator.write(number, tmp_path)
        before = path.read_bytes()
        assert generator.write(number, tmp_path)[0].read_bytes() == before


def test_the_harness_sees_tracebacks_crashes_and_hangs(tmp_path: Path) -> None:
    """What it is there for, told apart: a broken program stands in for `foten`."""
    cases = [["fine"], ["refused"], ["two lines"], ["raises"], ["crashes"], ["hangs"], ["fine"]]
    program = {
        "fine": "return 0",
        "refused": "print('one line', file=sys.stderr); return 2",
        "two lines": "print('one\\ntwo', file=sys.stderr); return 2",
        "raises": "raise RuntimeError",
        "crashes": "os.kill(os.getpid(), signal.SIGSEGV)",
        "hangs": "time.sleep(60)",
    }
    body = "\n".join(f"    if arguments == [{name!r}]: {code}" for name, code in program.items())
    (tmp_path / "broken.py").write_text(f"import os, signal, sys, time\ndef _status(arguments):\n{body}\n")
    results = run_commands(cases, longest_s=1.0, of="broken", path=tmp_path)
    assert [result.clean for result in results] == [True, True, False, False, False, False, True]
    assert [result.status for result in results] == [0, 2, 2, 99, -11, None, 0]
