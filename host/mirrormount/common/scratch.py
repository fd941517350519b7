"""A folder for files of the moment. Imports nothing of the host."""

import contextlib
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

with contextlib.suppress(OSError):
    tempfile.gettempdir()  # it tries a folder by a file of its own: here, before a signal may end the program


@contextlib.contextmanager
def scratch_folder() -> Iterator[str]:
    """The path of a new folder of this user's. It is gone at the end, also if a signal (signals.py) comes meanwhile.

    tempfile's own leaves the folder behind if the signal comes while it is made or removed. Raises OSError.
    """
    folder = Path(tempfile.gettempdir(), f"mirrormount-{secrets.token_hex(8)}")
    try:
        folder.mkdir(mode=0o700)
        yield str(folder)
    finally:
        try:
            shutil.rmtree(folder, ignore_errors=True)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)  # no second signal comes
            raise
