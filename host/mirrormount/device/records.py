"""Small databases in the user's folder for data: what moved (motion_log.py), and what was before (presets.py).

SQLite, since several programs may write at a time. The folder is $MIRRORMOUNT_CONFIG, else the user's one for data. A
file is made when it is first written.
"""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from mirrormount.errors import BadFile, CannotWrite
from mirrormount.terminal import printable

if TYPE_CHECKING:
    import sqlite3

_CHANGES = slice(24, 28)  # SQLite's change counter in the file's header (its page "Database File Format")
_BUSY_S = 1.0  # how long another program's writing is waited for


def path(name: str) -> Path:
    """Where the database called `name` is."""
    folder = os.environ.get("MIRRORMOUNT_CONFIG")
    if folder:
        return Path(folder) / name
    from platformdirs import user_data_path  # a stop needs none of it

    return user_data_path("mirrormount", appauthor=False) / name


def version(name: str) -> bytes:
    """Another one after each change of the database, by whatever program; b"" if it is not there."""
    with contextlib.suppress(OSError), path(name).open("rb") as file:
        return file.read(_CHANGES.stop)[_CHANGES]
    return b""


@contextlib.contextmanager
def opened(name: str, schema: str, *, write: bool = False) -> Iterator["sqlite3.Connection"]:
    """A connection; what is written in the block is kept as a whole, or not at all, and no other program writes then.

    schema makes the tables that are missing. To read a file that is not there makes none. Raises BadFile if it is
    damaged, CannotWrite if nothing more can be written: a full disk, no rights, or another program is busy with it.
    """
    try:
        import sqlite3  # a stop needs none of it
    except ImportError as e:
        raise CannotWrite(f"{name}: this Python was built without sqlite3") from e
    file = path(name)
    try:
        if write:
            file.parent.mkdir(parents=True, exist_ok=True)
        is_there = file.exists() and file.stat().st_size > 0  # a full disk leaves an empty one
        where = str(file) if write or is_there else ":memory:"
        with contextlib.closing(sqlite3.connect(where, timeout=_BUSY_S, isolation_level=None)) as connection:
            connection.execute("begin immediate" if write else "begin")
            for statement in schema.split(";") if write or not is_there else ():
                connection.execute(statement)
            yield connection
            connection.execute("commit")  # without it closing undoes all
    except (sqlite3.OperationalError, OSError) as e:
        raise CannotWrite(f"cannot use {file}: {printable(str(e))}") from e
    except sqlite3.Error as e:
        raise BadFile(f"{file}: damaged ({printable(str(e))}): move it away, and a new one is made") from e
