"""Writing files so that nothing is lost."""

from __future__ import annotations

import csv
import io
import os
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from glob import escape
from pathlib import Path
from typing import IO, Any

from eos_pin.errors import OutputError

#: A temporary file this old was left behind by a process that was killed [s].
STALE = 3600.0


def write_atomically(path: str | Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file beside `path` and rename it there, so that `path` is never half a file.

    What earlier writers of the same path left behind when they were killed is removed.

    Raises:
        OutputError: The file cannot be written.
    """
    path = Path(path)
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        for old in path.parent.glob(f".{escape(path.name)}.????????.part"):
            with suppress(OSError):
                if old.stat().st_mtime < time.time() - STALE:
                    old.unlink()
        # No object of Python's own, in whose __del__ Ctrl-C would be lost with a traceback.
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
        temporary = Path(name)
        os.close(handle)
        with temporary.open("w+b") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def check_writable(*paths: str | Path) -> None:
    """Refuse files and folders that could not be written, before the work for them begins.

    Raises:
        OutputError: A part of a path is a file, or no new file may be made there.
    """
    for path in map(Path, paths):
        there = next(parent for parent in (path.absolute(), *path.absolute().parents) if parent.exists())
        if there != path.absolute() and not there.is_dir():
            raise OutputError(f"cannot write {path}: {there} is a file, not a folder")
        if not os.access(there, os.W_OK):
            raise OutputError(f"cannot write {path}: {there} may not be written; choose another place")


def write_csv(path: str | Path, names: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table with the names of its columns in the first row.

    Raises:
        OutputError: The file cannot be written.
    """

    def write(file: IO[bytes]) -> None:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        table = csv.writer(text)
        table.writerow(names)
        table.writerows(rows)
        text.flush()
        text.detach()

    write_atomically(path, write)
