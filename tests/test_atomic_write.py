"""Files appear whole or not at all."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from foten.atomic_write import atomic_write


def test_a_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with atomic_write(path) as part:
        part.write_text("one")
        assert not path.exists()
    assert path.read_text() == "one"
    assert list(tmp_path.iterdir()) == [path]


def test_what_stood_there_stays_when_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def interrupted() -> None:
        with atomic_write(path) as part:
            part.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with pytest.raises(KeyError), atomic_write(path):  # before a byte is written
        raise KeyError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_two_writers_of_one_path_do_not_mix(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with atomic_write(path) as first, atomic_write(path) as second:
        assert first != second
        first.write_text("first")
        second.write_text("second, longer")
    assert path.read_text() == "first"


def _limited(code: str, folder: Path, max_bytes: int) -> subprocess.CompletedProcess[str]:
    """Run code where no file may grow beyond so many bytes, which fails as a full disk does."""
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({max_bytes}, {max_bytes}))"
    return subprocess.run([sys.executable, "-c", f"{limit}\n{code}"], cwd=folder, capture_output=True, text=True)


def test_a_full_disk_leaves_nothing_and_names_the_file(tmp_path: Path) -> None:
    code = (
        "from pathlib import Path; from foten.atomic_write import atomic_write\n"
        "with atomic_write(Path('a.txt')) as part: part.write_text('x' * 9999)"
    )
    done = _limited(code, tmp_path, 1000)
    assert "OSError: [Errno 27] File too large: 'a.txt'" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("max_bytes", [0, 1000, 100_000])
def test_simulate_on_a_full_disk_is_one_line(tmp_path: Path, max_bytes: int) -> None:
    (tmp_path / "a.h5").write_bytes(b"") if max_bytes else None
    code = "from foten.cli.command_line import _status; raise SystemExit(_status('simulate towel -o a.h5 --seconds 2'.split()))"
    done = _limited(code, tmp_path, max_bytes)
    assert (done.returncode, done.stderr) == (2, "foten: a.h5: file too large\n")
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"] * (max_bytes > 0)  # what stood there stays


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device here")
def test_the_system_s_own_word_for_full(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with pytest.raises(OSError, match="No space left on device") as refusal, atomic_write(path):
        Path("/dev/full").write_text("x" * 9999)
    assert refusal.value.filename == str(path)


def test_only_files_are_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="is a folder, a pipe or a device"), atomic_write(tmp_path / "pipe"):
        pass
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with atomic_write(tmp_path / "loop") as part:
        part.write_text("one")
    assert (tmp_path / "loop").read_text() == "one"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_refused_folder_is_named_by_the_file(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(PermissionError) as refusal, atomic_write(tmp_path / "a.txt") as part:
        part.write_text("one")
    assert refusal.value.filename == str(tmp_path / "a.txt")
