"""The files of a CircuitPython drive by their paths from its root. No path leaves the drive, and no link is followed.

A drive is untrusted input. FAT, CircuitPython's file system, has neither links nor device files. A drive that has some
in the place of the firmware's files is refused.
"""

import contextlib
import errno
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

from mirrormount.common.errors import WrongDrive
from mirrormount.common.printable import printable

_RELATIVE_TO_FOLDERS = {os.open, os.stat, os.mkdir, os.unlink, os.rmdir, os.rename} <= os.supports_dir_fd
_NOT_IN_FAT_NAMES = re.compile(r'[\x00-\x1f\x7f"*/:<>?\\|]')
# names of devices, with any ending (Windows)
_DEVICES = re.compile(r"(?:con|prn|aux|nul|conin\$|conout\$|com[0-9¹²³]|lpt[0-9¹²³])(?:\..*)?", re.IGNORECASE)
_LONGEST_NAME = 255
_DEEPEST = 8  # folders below one another; the firmware has two
_MOST_FILES = 5_000
_MOST_BYTES = 16 << 20  # of one file, or of all together: more than the flash of any board
_GONE = (errno.ENOENT, errno.ENOTEMPTY, errno.EEXIST)
_IS_A_LINK = (errno.ELOOP, errno.ENOTDIR, errno.EMLINK)  # errors of O_NOFOLLOW


def is_path(text: object) -> bool:
    """True for a path that any drive can have: relative, with `/`, without `..` and names that Windows reserves."""
    if not isinstance(text, str) or not 0 < len(text) <= _LONGEST_NAME:
        return False
    return all(
        name not in ("", ".", "..")
        and not name.endswith((" ", "."))
        and not _NOT_IN_FAT_NAMES.search(name)
        and not _DEVICES.fullmatch(name.rstrip())
        and name.isprintable()
        for name in text.split("/")
    )


def read_beginning(root: Path, name: str, longest: int) -> bytes:
    """The first bytes of a file in a drive's root, at most `longest`. Raises OSError, WrongDrive."""
    with Files(root).opened(name, os.O_RDONLY) as descriptor:
        return os.read(descriptor, longest)


class Files:
    """A drive's files. A method that writes has flushed the system's cache when it returns.

    All methods raise OSError, and WrongDrive for a link, a device, or an impossible path.
    """

    def __init__(self, root: Path) -> None:
        self.root = root

    def read(self, path: str) -> bytes:
        """A file's content: on Linux from the drive, elsewhere perhaps from the system's cache."""
        with self.opened(path, os.O_RDONLY) as descriptor, open(descriptor, "rb", closefd=False) as f:
            if hasattr(os, "posix_fadvise"):
                os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
            content = f.read(_MOST_BYTES + 1)
        if len(content) > _MOST_BYTES:
            raise WrongDrive(f"{printable(path)} on the drive is larger than a board's flash: nothing was changed")
        return content

    def contents(self, paths: list[str]) -> dict[str, bytes]:
        """{path: content}. Raises WrongDrive if it is more than a board's flash can hold."""
        found: dict[str, bytes] = {}
        left = _MOST_BYTES
        for path in paths:
            found[path] = self.read(path)
            left -= len(found[path])
            if left < 0:
                raise WrongDrive("the drive holds more than a board's flash: nothing was changed")
        return found

    def write(self, path: str, content: bytes) -> None:
        """Write a file in place."""
        flags = os.O_WRONLY | os.O_CREAT
        with self.opened(path, flags) as descriptor, open(descriptor, "wb", closefd=False) as f:
            f.truncate(0)
            f.write(content)
            f.flush()
            os.fsync(descriptor)

    def rename(self, path: str, to: str) -> None:
        """Rename a file; another of that name is replaced."""
        with self._at(path) as (old, old_folder), self._at(to) as (new, new_folder):
            os.replace(old, new, src_dir_fd=old_folder, dst_dir_fd=new_folder)
        self.sync()

    def remove(self, path: str) -> None:
        """Remove a file."""
        with self._at(path) as (name, folder):
            os.remove(name, dir_fd=folder)

    def make_folder(self, path: str) -> None:
        """Make a folder, unless it exists."""
        with self._at(path) as (name, folder):
            with contextlib.suppress(FileExistsError):
                os.mkdir(name, dir_fd=folder)
            if not stat.S_ISDIR(_no_link(path, os.stat(name, dir_fd=folder, follow_symlinks=False))):
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), path)

    def remove_folder(self, path: str) -> None:
        """Remove a folder if it exists and is empty."""
        try:
            with self._at(path) as (name, folder):
                os.rmdir(name, dir_fd=folder)
        except OSError as e:
            if e.errno not in _GONE:
                raise

    def sync(self) -> None:
        """Flush the system's cache. Windows has no such call: there write() flushes each file."""
        if hasattr(os, "sync"):
            os.sync()

    def exists(self, path: str) -> bool:
        """True if there is such a file."""
        try:
            with self._at(path) as (name, folder):
                mode = _no_link(path, os.stat(name, dir_fd=folder, follow_symlinks=False))
        except FileNotFoundError:
            return False
        return stat.S_ISREG(mode)

    def listed(self, folder: str = "") -> list[str]:
        """The paths of the files in a folder and below it ("": in the root, not below); empty without such a folder.

        Names that is_path() refuses are left out.
        """
        try:
            return list(self._walk(folder, 0))
        except FileNotFoundError:
            return []

    def _walk(self, folder: str, depth: int) -> Iterator[str]:
        below = []
        with self._folder(folder.split("/") if folder else []) as place, os.scandir(place) as entries:
            for number, entry in enumerate(entries):
                if depth > _DEEPEST or number > _MOST_FILES:
                    raise WrongDrive(f"{folder} on the drive holds more than any firmware: nothing was changed")
                path = f"{folder}/{entry.name}" if folder else entry.name
                if not is_path(path):
                    continue
                if folder and _no_link(path, entry.stat(follow_symlinks=False)) and entry.is_dir(follow_symlinks=False):
                    below.append(path)
                elif not entry.is_dir(follow_symlinks=False):
                    yield path
        for path in below:
            yield from self._walk(path, depth + 1)

    @contextlib.contextmanager
    def opened(self, path: str, flags: int) -> Iterator[int]:
        """A file's descriptor: of a plain file on this drive, without a second name."""
        flags |= getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        with self._at(path) as (name, folder):
            with contextlib.suppress(FileNotFoundError):  # opening a device can have effects
                _no_link(path, os.stat(name, dir_fd=folder, follow_symlinks=False))
            try:
                descriptor = os.open(name, flags | getattr(os, "O_CLOEXEC", 0), 0o666, dir_fd=folder)
            except OSError as e:
                if e.errno in _IS_A_LINK:
                    raise _link(path) from e
                raise
        try:
            found = os.fstat(descriptor)
            if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
                raise _link(path)
            yield descriptor
        finally:
            os.close(descriptor)

    @contextlib.contextmanager
    def _at(self, path: str) -> Iterator[tuple[str, int | None]]:
        """(name, descriptor of its folder); on a system without such calls (whole path, None)."""
        if not is_path(path):
            raise WrongDrive(f"{printable(path)} is not a path on a drive: nothing was done with it")
        *folders, name = path.split("/")
        with self._folder(folders) as place:
            if isinstance(place, int):
                yield name, place
            else:
                yield os.path.join(place, name), None

    @contextlib.contextmanager
    def _folder(self, folders: list[str]) -> Iterator[int | str]:
        """The descriptor of a folder, opened name by name; its path on a system that cannot do that (Windows)."""
        if not _RELATIVE_TO_FOLDERS:
            place = str(self.root)
            for name in folders:
                place = os.path.join(place, name)
                if not stat.S_ISDIR(_no_link(name, os.stat(place, follow_symlinks=False))):
                    raise _link(name)
            yield place
            return
        flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
        descriptor = os.open(self.root, flags)
        try:
            for name in folders:
                try:
                    inner = os.open(name, flags | os.O_NOFOLLOW, dir_fd=descriptor)
                except OSError as e:
                    if e.errno in _IS_A_LINK:
                        raise _link(name) from e
                    raise
                os.close(descriptor)
                descriptor = inner
            yield descriptor
        finally:
            os.close(descriptor)


def _no_link(path: str, found: os.stat_result) -> int:
    """The mode of an entry. Raises WrongDrive if it is neither a plain file nor a folder."""
    if getattr(found, "st_reparse_tag", 0) or not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        raise _link(path)
    return found.st_mode


def _link(path: str) -> WrongDrive:
    return WrongDrive(
        f"{printable(path)} on the drive is a link or no plain file, which CircuitPython never makes there: this is not"
        " the drive of such a board, or somebody has prepared it; nothing behind the link was read or written"
    )
