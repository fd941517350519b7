"""Files that hold the old content or the new, never a part of it. Imports errors."""

import contextlib
import os
import tempfile
from pathlib import Path

from mirrormount.common.errors import CannotWrite

_TRIAL = bytes(1 << 16)  # as many bytes as a small file has: a full disk still takes an empty one


def write(path: Path, content: str | bytes, *, make_folder: bool = False) -> None:
    """Put content into a file: it then holds the old or the new, never a part.

    Nothing is written through a link. A folder is made only if make_folder says so. Raises CannotWrite.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        new = _beside(path, data, make_folder)
        try:
            new.chmod(0o666 & ~_umask())
            new.replace(path)
        except BaseException:
            _remove(new)
            raise
    except OSError as e:
        raise CannotWrite(f"cannot write {path}: {e.strerror}") from e


def check_writable(path: Path, *, make_folder: bool = False) -> None:
    """Raise CannotWrite if write() would: for work whose result must not be lost. Makes the folder as write() does."""
    try:
        _remove(_beside(path, _TRIAL, make_folder))
    except OSError as e:
        raise CannotWrite(f"cannot write {path}: {e.strerror}") from e


def _beside(path: Path, data: bytes, make_folder: bool) -> Path:
    """A new file in the folder of path that holds data. Raises CannotWrite, OSError; then there is none."""
    if path.is_symlink():
        raise CannotWrite(f"cannot write {path}: it is a link; name the file itself")
    if not path.name or (path.exists() and not path.is_file()):
        raise CannotWrite(f"cannot write {path}: it is not a file")
    if make_folder:
        path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name[:80]}.", dir=path.parent)
    new = Path(name)  # made by us alone: nobody can have put a link in its place
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except BaseException:  # Ctrl-C, too
        _remove(new)
        raise
    return new


def _remove(file: Path) -> None:
    with contextlib.suppress(OSError):
        file.unlink()


def behind(path: Path) -> Path:
    """The file that a user's own link leads to, for write(): the link stays."""
    return Path(os.path.realpath(path))


def check_replaceable(path: Path, begins: str) -> None:
    """Raise CannotWrite if what is at path would be lost: a file that does not begin like its own kind, or no file."""
    try:
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise CannotWrite(f"cannot write {path}: it is a link, or not a file")
        if not path.exists():
            return
        with path.open("rb") as file:
            begun = file.read(len(begins))
    except OSError as e:
        raise CannotWrite(f"cannot write {path}: {e.strerror}") from e
    if begun and begun != begins.encode():
        raise CannotWrite(f"cannot write {path}: a file of that name exists, and is no report; name another one")


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
