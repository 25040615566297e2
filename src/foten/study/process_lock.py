"""A lock on a file that one process has, and that ends with the process, however that ends."""

from __future__ import annotations

from pathlib import Path


class ProcessLock:
    """A lock, from construction to `close`.

    Raises:
        OSError: another process has it.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("a+b")
        try:
            _lock(self._file.fileno())
        except OSError as error:
            self._file.close()
            raise OSError(f"{path.stem} is in use: end the 'foten study run' of it first") from error

    def close(self) -> None:
        """Unlock."""
        self._file.close()


def _lock(file: int) -> None:
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    else:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
