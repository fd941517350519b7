"""The file operations of a deploy on a CircuitPython drive, in the order that circuitpython_plan.py explains.

While code.py does nothing, no program reads the firmware's files, so they are written in place. CircuitPython reads
code.py and boot.py, and a later deploy relies on the manifest and on the copies of the user's files: these are written
under another name, read back, and renamed. FAT has no journal: a power cut inside one operation can still damage it.
"""

import contextlib
import errno
import hashlib
from collections.abc import Iterable, Iterator

from mirrormount.common.errors import DeployError, DriveFailed, DriveFull, DriveReadOnly
from mirrormount.common.progress import Progress
from mirrormount.deploy.circuitpython_plan import (
    BOOT,
    CODE,
    PROGRAMS,
    STUB,
    DrivePlan,
    Manifest,
    belongs,
    leftovers,
    read_manifest,
    sha256,
)
from mirrormount.deploy.fileset import folders
from mirrormount.deploy.on_board import MANIFEST
from mirrormount.transport.circuitpy_files import Files
from mirrormount.transport.volumes import Room

READ_ONLY = (
    "the drive is read-only: start the board in safe mode, where no boot.py can keep the drive for itself (press reset,"
    " or BOOTSEL where there is none, while the LED blinks after power-up); or unplug it and plug it in; or mount it so"
    " that this user may write"
)
_SPARE_CLUSTERS = 4  # for folders that grow
_LIBRARY = "lib/adafruit_motor"


def survey(files: Files) -> tuple[dict[str, str], dict[str, int], Manifest]:
    """{path: SHA-256} and {path: size in bytes} of the files that a deploy may touch, and the manifest.

    Raises DriveFailed.
    """
    with _told("nothing was changed"):
        paths = [path for path in files.listed() if path.lower().startswith((*PROGRAMS, "code.txt"))]
        for folder in ("mountfw", "lib/adafruit_motor"):
            paths += files.listed(folder)
        content = {_name(path): text for path, text in files.contents(paths).items()}
    hashes = {name: hashlib.sha256(text).hexdigest() for name, text in content.items()}
    return hashes, {name: len(text) for name, text in content.items()}, read_manifest(content.get(MANIFEST, b""))


def kept_sources(files: Files, todo: DrivePlan, wanted: Iterable[str]) -> dict[str, bytes]:
    """{path: content} of the user's own files in mountfw/, such as a board file. Raises DriveFailed."""
    kept = [path for path in todo.after.keys() - set(wanted) if path.startswith("mountfw/")]
    with _told("nothing was changed"):
        return {path: files.read(path) for path in kept if path.endswith((".py", ".mpy"))}


def _folders(paths: Iterable[str]) -> tuple[str, ...]:
    """The folders of these files, each after its parent."""
    return ("lib", _LIBRARY, *folders(paths))


def _name(path: str) -> str:
    """The path in lower case if it is a program's: FAT ignores case, and some systems write CODE.PY."""
    return path.lower() if path.lower() in PROGRAMS else path


def check_writable(room: Room) -> None:
    """Raise DriveReadOnly for a drive that cannot be written to."""
    if room.read_only:
        raise DriveReadOnly(f"{READ_ONLY}; nothing was changed")


def check_room(todo: DrivePlan, sizes: dict[str, int], room: Room) -> None:
    """Raise DriveReadOnly or DriveFull if the files do not fit on the drive. Counts whole clusters, as FAT does."""
    if todo.nothing:
        return
    check_writable(room)
    freed = sum(room.clusters(sizes[path]) for path in (*todo.remove, *todo.write) if path in sizes and path != BOOT)
    beside = [len(todo.during), len(todo.manifest), len(STUB), len(todo.code), *(sizes[path] for path in todo.aside)]
    need = sum(room.clusters(size) for size in (*map(len, todo.write.values()), *beside))
    need += len(_folders(todo.write)) + _SPARE_CLUSTERS - freed
    if need > room.free:
        kilo = room.cluster_bytes / 1024
        raise DriveFull(
            f"the drive is full: {need * kilo:.0f} KB more are needed, {room.free * kilo:.0f} KB are free (in clusters"
            f" of {room.cluster_bytes} bytes); nothing was changed"
        )


def install(files: Files, todo: DrivePlan, progress: Progress) -> None:
    """Execute the plan, and read back what was written. Raises DriveFull, DriveReadOnly, DriveFailed."""
    with _told("nothing of the firmware was changed"):
        for folder in _folders(todo.write):
            files.make_folder(folder)
        for path, copy in todo.aside.items():
            _beside(files, copy, files.read(path))
        _beside(files, MANIFEST, todo.during)
    with _told("nothing runs on the board now: deploy again"):
        _beside(files, CODE, STUB)
        for path in filter(files.exists, todo.remove):  # a leftover may have been renamed into place
            files.remove(path)
        progress.phase(f"copying {len(todo.write)} files")
        for number, (path, content) in enumerate(todo.write.items()):
            progress.bar(number, len(todo.write), path)
            if path == BOOT:
                _beside(files, path, content)
            else:
                files.write(path, content)
        files.sync()
        progress.phase("reading back")
        for path, sha in todo.after.items():
            if path in todo.write and sha256(files.read(path)) != sha:
                raise DriveFailed(
                    f"{path} is not on the drive as it was sent; nothing runs on the board now: deploy again"
                )
        _beside(files, MANIFEST, todo.manifest)
        _beside(files, CODE, todo.code)
        files.sync()


class WayBack:
    """The drive's files before a deploy, kept in this computer's memory: the drive has no room for both."""

    def __init__(self, files: Files, todo: DrivePlan) -> None:
        """Read the files that the plan will change. Raises DriveFailed."""
        self._files = files
        with _told("nothing was changed"):
            paths = (*todo.write, *todo.remove, CODE, MANIFEST)
            self._was = {path: files.read(path) for path in paths if files.exists(path)}
            self._copies = [copy for copy in todo.aside.values() if not files.exists(copy)]
        write = {path: self._was[path] for path in sorted(self._was, key=_late) if path not in (CODE, MANIFEST)}
        self._plan = DrivePlan(
            aside={},
            remove=[path for path in todo.write if path not in self._was],
            write=write,
            during=todo.during,
            manifest=self._was.get(MANIFEST, todo.during),
            code=self._was.get(CODE, STUB),
            changed=0,
            after={path: sha256(content) for path, content in write.items()},
        )

    def go(self, progress: Progress) -> None:
        """Restore them. Raises DriveFull, DriveReadOnly, DriveFailed."""
        install(self._files, self._plan, progress)
        with _told("what was there before is back, and some files of the deploy are still there"):
            absent = [path for path in (CODE, MANIFEST) if path not in self._was]
            for path in filter(self._files.exists, (*self._copies, *absent)):
                self._files.remove(path)
            for folder in reversed(_folders((*self._plan.remove, *self._plan.write))):
                self._files.remove_folder(folder)
            self._files.sync()


def _late(path: str) -> tuple[bool, str]:
    """Sort key: the programs that CircuitPython runs at start-up come last."""
    return "/" not in path, path


def remove(files: Files) -> tuple[list[str], list[str], list[str]]:
    """Remove what deploy has put there, and rename the user's files back. Returns removed, kept, restored paths."""
    there, _, old = survey(files)
    ours = [path for path in sorted(old.files) if belongs(path, there, old)]  # boot.py and code.py come first
    restored = {path for path, (_, sha) in old.aside.items() if there.get(path) == sha}  # before a cut
    kept = [path for path in sorted(old.files) if path in there and path not in (*ours, *restored)]
    back = {path: copy for path, (copy, sha) in old.aside.items() if path not in kept and there.get(copy) == sha}
    back = {path: copy for path, copy in back.items() if path not in restored}
    with _told("what is left was put there by deploy: say undeploy again"):
        for path in (*sorted(ours, key=lambda path: path != CODE), *leftovers(there)):
            files.remove(path)
        for path, copy in sorted(back.items(), reverse=True):  # code.py last
            files.rename(copy, path)
        if old.files:
            files.remove(MANIFEST)
        for folder in reversed(_folders(old.files)):
            files.remove_folder(folder)
        files.sync()
    return ours, kept, sorted(back)


def _beside(files: Files, path: str, content: bytes) -> None:
    """Write path under another name and rename it: after a power cut it has its old content or its new one."""
    if files.exists(path) and files.read(path) == content:
        return
    files.write(path + ".new", content)
    if files.read(path + ".new") != content:
        raise DriveFailed(f"{path} does not arrive on the drive as it was sent")
    files.rename(path + ".new", path)


@contextlib.contextmanager
def _told(state: str) -> Iterator[None]:
    """Turn an OSError into a DeployError whose message ends with the state of the drive."""
    try:
        yield
    except DeployError:
        raise
    except OSError as e:
        if e.errno == errno.ENOSPC:
            raise DriveFull(f"the drive is full; {state}") from e
        if e.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
            raise DriveReadOnly(f"{READ_ONLY}; {state}") from e
        raise DriveFailed(f"the drive does not work, or has gone ({e.strerror or e}); {state}") from e
