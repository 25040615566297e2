"""Files that appear whole or not at all."""

import errno
import json
import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Temporary name beside a path, to write to: it replaces the path at the end, and is removed where writing fails.

    Raises:
        OSError: with the path's own name, where the system refuses: no space is left, or the folder is read-only.
    """
    # A new name each time: two programs that write one path cannot mix their bytes.
    part = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part")
    try:
        if path.exists() and not path.is_file():
            raise OSError(None, "is a folder, a pipe or a device, expected a file or nothing", str(path))
        yield part
        part.replace(path)
    except OSError as error:
        # A full disk names no file, and a refused folder names the temporary one.
        if error.filename in (str(part), part) or (error.filename is None and error.errno in _FULL):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    finally:
        with suppress(OSError):
            part.unlink()


def write_json(path: Path, document: Mapping[str, Any], indent: int | None = 1) -> None:
    """Write a document as JSON, whole or not at all."""
    with atomic_write(path) as part:
        part.write_text(json.dumps(document, indent=indent, allow_nan=False) + "\n", encoding="utf-8")


def reason(error: Exception) -> str:
    """Reason of an error, in a line; of a system's refusal the file first, without the number."""
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return f"{error.filename}: {error.strerror[:1].lower()}{error.strerror[1:]}"
    return str(error) or type(error).__name__
