"""`mirrormount deploy` and `undeploy` for a CircuitPython board: files to its drive, commands to its serial ports.

A deploy interrupts the program on the console (at its prompt CircuitPython does not restart a program whose files
change), copies what differs to the drive and reads it back (install), restarts the board, and compares the hash that
the firmware answers with that of what was sent (_listen).

FAT has no exchange of folders, and at start-up the board runs code.py, whatever else the drive holds. So code.py is
replaced first, by STUB, and the new code.py comes last. A deploy that is cut anywhere leaves the old firmware, or the
new one, or a board that does nothing, but never a mix of versions.
"""

import contextlib
import errno
import hashlib
import importlib.util
import json
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from serial.tools import list_ports

from mirrormount.deploy import firmware, prompt
from mirrormount.deploy.firmware import THIS, answers, check_board_file, check_choice, folders, hashes, sources
from mirrormount.deploy.on_board import MANIFEST
from mirrormount.deploy.prompt import Options, ask, check, may_replace, quiet
from mirrormount.errors import (
    CannotOpen,
    ConnectionLost,
    DeployError,
    DriveFailed,
    DriveFull,
    DriveReadOnly,
    FirmwareFailed,
    LibraryMissing,
    MountError,
    NoAnswer,
    NotSeenRunning,
)
from mirrormount.supported import CIRCUITPYTHON
from mirrormount.terminal import Progress, printable
from mirrormount.terminal import install_command as how_to_install
from mirrormount.transport import discovery
from mirrormount.transport.discovery import Channels, Drive, channels, check_version, untried
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_port
from mountfw import __version__

CODE, BOOT = "code.py", "boot.py"
PROGRAMS = firmware.PROGRAMS["circuitpython"]
STUB = b'print("mirrormount: a deploy of the firmware was not finished. Nothing runs: deploy again.")\n'
READ_ONLY = (
    "the drive is read-only: start the board in safe mode, where no boot.py can keep the drive for itself (press reset,"
    " or BOOTSEL where there is none, while the LED blinks after power-up); or unplug it and plug it in; or mount it so"
    " that this user may write"
)
_BEFORE_OURS = "code.txt"  # CircuitPython runs it instead of code.py
_FRESH = b'print("Hello World!")\n'  # the code.py that CircuitPython writes on a new drive: no user's work
_LIBRARY = "lib/adafruit_motor"
_SPARE_CLUSTERS = 4  # for folders that grow
_IDENTITY = re.compile(r"mirrormount,([^,]*),[^,]*,([^\s,]+)")
_BACK_S = 30.0  # for a reset: 1 s of safe-mode wait, 1 s before boot_out.txt, USB, and the imports
_BY_HAND_S = 60.0  # for a person to find and press the reset button
_AGAIN_S = 0.2
_PROMPT_S = 6.0  # until the prompt comes
_QUIET_S = 0.2
_LAST_WORDS_S = 3.0
_START_S = 20.0  # how long a program may take to fail: all of it is compiled first
_ENDED = (b"Code done running", b"Press any key", b">>> ")  # CircuitPython's output after a program
_KEYS = 8  # times that a key is sent between two Ctrl-C


def deploy(drive: Drive, this: dict[str, bytes], options: Options, progress: Progress) -> str:
    """Put the firmware on the drive, with the files `this`, which choose the board file. Returns one line for the user.

    Raises DeployError, CannotOpen, ConnectionLost; the message says what is on the drive then.
    """
    started = time.monotonic()
    check_version(drive)
    if untried(drive):
        progress.phase(f"CircuitPython {drive.version} is newer than any that was tried ({CIRCUITPYTHON.span})")
    wanted = sources("circuitpython") | motor_library() | this
    files = Files(drive.path)
    progress.phase(f"looking at {drive}")
    there, sizes, old = survey(files)
    check_choice(options.board, {*wanted, *there})
    check_board_file(drive.board_id, {*wanted, *there})
    todo = drive_plan(wanted, there, old, may_replace(options))
    check_room(todo, sizes, _room(drive))
    expected = answers(wanted | kept_sources(files, todo, wanted))
    if todo.nothing:
        told = _already(drive, options.stop, expected)
    else:
        with _at_prompt(drive, options.stop) as ports:
            install(files, todo, progress)
            longest_s = _restart(ports, progress)
        told = _listen(drive, expected, longest_s)
    count = f"{len(wanted)} files ({len(wanted) - todo.changed} unchanged)"
    kept = "".join(f"; the {path} that was there is now {copy}" for path, copy in todo.aside.items())
    return f"OK: {told}, {count} in {time.monotonic() - started:.1f} s{kept}"


def undeploy(drive: Drive, options: Options, progress: Progress) -> str:
    """Remove what deploy has put on the drive, and nothing else. Returns one line for the user.

    Raises DeployError, CannotOpen, ConnectionLost.
    """
    files = Files(drive.path)
    if not survey(files)[2].files:
        raise DeployError(f"{drive} has no firmware that deploy has put there: nothing was removed")
    check_writable(_room(drive))
    with _at_prompt(drive, options.stop) as ports:
        progress.phase("removing")
        removed, kept, restored = remove(files)
        if ports.console:
            reset(ports.console)
    again = "" if ports.console else "; now press the board's reset button"
    back = f"; there again: {printable(', '.join(restored))}" if restored else ""
    changed = f"; kept, because changed since: {printable(', '.join(kept))}" if kept else ""
    return f"OK: {len(removed)} files removed{back}{changed}{again}"


# ---- which files, and which steps


def motor_library() -> dict[str, bytes]:
    """{path on the drive: content} of the part of adafruit_motor that drives DC motors. Raises LibraryMissing.

    The package is found, but not imported: its import needs a board.
    """
    try:
        spec = importlib.util.find_spec("adafruit_motor")
        places = spec.submodule_search_locations if spec else None
        folder = Path((places or ["there is none"])[0])
        return {f"{_LIBRARY}/{name}": (folder / name).read_bytes() for name in ("__init__.py", "motor.py")}
    except (OSError, ValueError) as e:
        raise LibraryMissing(
            "Adafruit's motor library, which goes onto CircuitPython boards, is not installed here:"
            f" {how_to_install('circuitpython')}"
        ) from e


@dataclass(frozen=True)
class Manifest:
    """The list that an earlier deploy has left on the drive."""

    files: dict[str, str] = field(default_factory=dict)  # {path: SHA-256} of the files that it wrote
    aside: dict[str, list[str]] = field(default_factory=dict)  # {the user's file: [its copy, SHA-256]}
    # of a deploy that was cut: {path: SHA-256} of the programs before it; its other files may be half written
    unfinished: dict[str, str] | None = None

    def text(self) -> bytes:
        """The manifest as JSON; `version` and `files` are as on MicroPython."""
        told = {"version": __version__, "files": dict(sorted(self.files.items()))}
        if self.aside:
            told["aside"] = dict(sorted(self.aside.items()))
        if self.unfinished is not None:
            told["unfinished"] = self.unfinished
        return json.dumps(told, indent=1).encode()


def read_manifest(text: bytes) -> Manifest:
    """The manifest in this text; an empty one if FAT has lost it or a person has changed its form."""
    try:
        told = json.loads(text)
        aside = {path: [copy, sha] for path, (copy, sha) in told.get("aside", {}).items()}
        return Manifest(dict(told["files"]), aside, told.get("unfinished"))
    except (ValueError, KeyError, TypeError, AttributeError):
        return Manifest()


@dataclass(frozen=True)
class DrivePlan:
    """The steps of a deploy on a drive. MANIFEST has the content `during` while it runs, then `manifest`."""

    aside: dict[str, str]  # {the user's file: its copy}
    remove: list[str]
    write: dict[str, bytes]  # without code.py and the manifest
    during: bytes
    manifest: bytes
    code: bytes
    changed: int  # files of the firmware that are new or differ
    after: dict[str, str]  # {path: SHA-256} at the end

    @property
    def nothing(self) -> bool:
        """True if the drive needs no change."""
        return not self.during


def drive_plan(
    wanted: dict[str, bytes], there: dict[str, str], old: Manifest, may_replace: Callable[[dict[str, str]], bool]
) -> DrivePlan:
    """The plan that makes a drive with the files `there` ({path: SHA-256}) hold `wanted`.

    A file that is neither wanted nor of an earlier deploy stays. may_replace gets the user's files that are in the way,
    {path: name of the copy}. Raises DeployError if it returns False.
    """
    wanted_hashes = hashes(wanted)
    aside = _aside(wanted_hashes, there, old)
    if aside and not may_replace(aside):
        raise DeployError(
            f"the drive has files of somebody else ({', '.join(sorted(aside))}): nothing was changed; to replace them"
            f" (copies stay as {', '.join(sorted(aside.values()))}) say --replace-main"
        )
    ours = dict(wanted_hashes)
    if THIS in old.files and THIS in there:  # an earlier choice stays
        ours.setdefault(THIS, old.files[THIS])
    kept = old.aside | {path: [copy, there[path]] for path, copy in aside.items()}
    manifest = Manifest(ours, kept).text()
    gone = {path for path in old.files if path not in ours and belongs(path, there, old)}
    gone |= {path.removesuffix(".py") + ".mpy" for path in wanted if path.startswith("mountfw/")}
    gone |= leftovers(there)
    gone |= aside.keys() - wanted.keys()
    changed = {path for path in wanted if there.get(path) != wanted_hashes[path]}
    # the library first, boot.py last: it runs at start-up, so it changes as late as possible
    order = sorted(changed - {CODE}, key=lambda path: (path == BOOT, path))
    remove = sorted(gone & set(there))
    as_it_is = not (aside or remove or changed) and there.get(MANIFEST) == _sha256(manifest)
    present = {path: there[path] for path in PROGRAMS if belongs(path, there, old)}
    during = b"" if as_it_is else Manifest(old.files | ours, kept, present).text()
    after = there | wanted_hashes | {MANIFEST: _sha256(manifest)}
    after = {path: sha for path, sha in after.items() if path not in gone}
    after |= {copy: there[path] for path, copy in aside.items()}
    write = {path: wanted[path] for path in order}
    return DrivePlan(aside, remove, write, during, manifest, wanted[CODE], len(changed), after)


def leftovers(there: Iterable[str]) -> set[str]:
    """Files that a deploy wrote to rename them into place, and was cut before."""
    return {path for path in there if path.endswith(".new") and path.startswith((*PROGRAMS, _BEFORE_OURS, MANIFEST))}


def belongs(path: str, there: dict[str, str], old: Manifest) -> bool:
    """True if a deploy wrote the file at path, and it is unchanged since."""
    present = there.get(path)
    if present is None or path not in old.files:
        return False
    if present == old.files[path] or (path == CODE and present == _sha256(STUB)):
        return True
    if old.unfinished is None:
        return False
    # programs are renamed into place, so they are never half written
    return path not in PROGRAMS or present == old.unfinished.get(path)


def _aside(wanted: dict[str, str], there: dict[str, str], old: Manifest) -> dict[str, str]:
    """{path: name of its copy} of the user's files that are in the way. No older copy is overwritten."""
    found = {}
    for path in (*wanted, _BEFORE_OURS):
        present = there.get(path)
        nobodys = present in (None, wanted.get(path), _sha256(STUB)) or (path == CODE and present == _sha256(_FRESH))
        if path.startswith("mountfw/") or nobodys or belongs(path, there, old):
            continue
        copy, sha = old.aside.get(path, ["", ""])
        if old.unfinished is not None and sha == present == there.get(copy) and path in wanted:  # copied before the cut
            continue
        number = 1
        while there.get(name := f"{path}.bak{number if number > 1 else ''}", present) != present:
            number += 1
        found[path] = name
    return found


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


# ---- the drive


class Files:
    """A drive's files by their paths from its root. All methods raise OSError."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def read(self, path: str) -> bytes:
        """A file's content: on Linux from the drive, elsewhere perhaps from the system's cache."""
        with (self.root / path).open("rb") as f:
            if hasattr(os, "posix_fadvise"):
                os.posix_fadvise(f.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            return f.read()

    def write(self, path: str, content: bytes) -> None:
        """Write a file in place."""
        with (self.root / path).open("wb") as f:
            f.write(content)
            f.flush()
            os.fsync(f.fileno())

    def rename(self, path: str, to: str) -> None:
        """Rename a file; another of that name is replaced."""
        (self.root / path).replace(self.root / to)
        self.sync()

    def remove(self, path: str) -> None:
        """Remove a file."""
        (self.root / path).unlink()

    def make_folder(self, path: str) -> None:
        """Make a folder, unless it exists."""
        (self.root / path).mkdir(exist_ok=True)

    def remove_folder(self, path: str) -> None:
        """Remove a folder if it exists and is empty."""
        if (self.root / path).is_dir() and not any((self.root / path).iterdir()):
            (self.root / path).rmdir()

    def sync(self) -> None:
        """Flush the system's cache. Windows has no such call: there write() flushes each file."""
        if hasattr(os, "sync"):
            os.sync()

    def exists(self, path: str) -> bool:
        """True if there is such a file."""
        return (self.root / path).is_file()

    def listed(self, folder: str = "") -> list[str]:
        """The paths of the files in a folder and below it ("": in the root, not below); empty without such a folder."""
        found = (self.root / folder).rglob("*") if folder else self.root.iterdir()
        return sorted(path.relative_to(self.root).as_posix() for path in found if path.is_file())


def survey(files: Files) -> tuple[dict[str, str], dict[str, int], Manifest]:
    """{path: SHA-256} and {path: size in bytes} of the files that a deploy may touch, and the manifest.

    Raises DriveFailed.
    """
    with _told("nothing was changed"):
        paths = [path for path in files.listed() if path.lower().startswith((*PROGRAMS, _BEFORE_OURS))]
        paths += files.listed("mountfw") + files.listed(_LIBRARY)
        # FAT ignores case, and some systems write CODE.PY
        content = {path.lower() if path.lower() in PROGRAMS else path: files.read(path) for path in paths}
    sizes = {name: len(text) for name, text in content.items()}
    return hashes(content), sizes, read_manifest(content.get(MANIFEST, b""))


def kept_sources(files: Files, todo: DrivePlan, wanted: Iterable[str]) -> dict[str, bytes]:
    """{path: content} of the user's own files in mountfw/, such as a board file. Raises DriveFailed."""
    kept = [path for path in todo.after.keys() - set(wanted) if path.startswith("mountfw/")]
    with _told("nothing was changed"):
        return {path: files.read(path) for path in kept if path.endswith((".py", ".mpy"))}


def _room(drive: Drive) -> discovery.Room:
    with _told("nothing was changed"):
        return discovery.room(drive.path)


def check_writable(room: discovery.Room) -> None:
    """Raise DriveReadOnly for a drive that cannot be written to."""
    if room.read_only:
        raise DriveReadOnly(f"{READ_ONLY}; nothing was changed")


def check_room(todo: DrivePlan, sizes: dict[str, int], room: discovery.Room) -> None:
    """Raise DriveReadOnly or DriveFull if the files do not fit on the drive. Counts whole clusters, as FAT does."""
    if todo.nothing:
        return
    check_writable(room)
    freed = sum(room.clusters(sizes[path]) for path in (*todo.remove, *todo.write) if path in sizes and path != BOOT)
    beside = [len(todo.during), len(todo.manifest), len(STUB), len(todo.code), *(sizes[path] for path in todo.aside)]
    need = sum(room.clusters(size) for size in (*map(len, todo.write.values()), *beside))
    need += len(folders(todo.write)) + _SPARE_CLUSTERS - freed
    if need > room.free:
        kilo = room.cluster_bytes / 1024
        raise DriveFull(
            f"the drive is full: {need * kilo:.0f} KB more are needed, {room.free * kilo:.0f} KB are free (in clusters"
            f" of {room.cluster_bytes} bytes); nothing was changed"
        )


def install(files: Files, todo: DrivePlan, progress: Progress) -> None:
    """Execute the plan, and read back what was written. Raises DriveFull, DriveReadOnly, DriveFailed.

    While code.py does nothing, no program reads the firmware's files, so they are written in place.
    """
    with _told("nothing of the firmware was changed"):
        for folder in folders(todo.write):
            files.make_folder(folder)
        for path, copy in todo.aside.items():
            _replace(files, copy, files.read(path))
        _replace(files, MANIFEST, todo.during)
    with _told("nothing runs on the board now: deploy again"):
        _replace(files, CODE, STUB)
        for path in filter(files.exists, todo.remove):  # a leftover may have been renamed into place
            files.remove(path)
        progress.phase(f"copying {len(todo.write)} files")
        for number, (path, content) in enumerate(todo.write.items()):
            progress.bar(number, len(todo.write), path)
            if path == BOOT:
                _replace(files, path, content)
            else:
                files.write(path, content)
        files.sync()
        progress.phase("reading back")
        for path in todo.write:
            if _sha256(files.read(path)) != todo.after[path]:
                raise DriveFailed(
                    f"{path} is not on the drive as it was sent; nothing runs on the board now: deploy again"
                )
        _replace(files, MANIFEST, todo.manifest)
        _replace(files, CODE, todo.code)
        files.sync()


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
        for folder in reversed(folders(old.files)):
            files.remove_folder(folder)
        files.sync()
    return ours, kept, sorted(back)


def _replace(files: Files, path: str, content: bytes) -> None:
    """Write path under another name and rename it: after a power cut it has its old content or its new one.

    So are written what CircuitPython runs at start-up, and what a later deploy relies on.
    """
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
    except OSError as e:
        if e.errno == errno.ENOSPC:
            raise DriveFull(f"the drive is full; {state}") from e
        if e.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
            raise DriveReadOnly(f"{READ_ONLY}; {state}") from e
        raise DriveFailed(f"the drive does not work, or has gone ({e.strerror or e}); {state}") from e


# ---- the console: interrupt the program, restart the board


@contextlib.contextmanager
def _at_prompt(drive: Drive, stop: bool) -> Iterator[Channels]:
    """Check that no motor moves, and interrupt the program. Gives the ports; within, the board is to be restarted.

    If what is done within fails or is ended, the board is restarted: it then runs its old program, or the code.py that
    does nothing. Raises DeployError, CannotOpen.
    """
    ports = _channels(drive)
    if drive.has_mountfw and ports.protocol:  # another program must not get this query
        link = Link(open_port(ports.protocol))
        try:
            link.drain(0.1)
            quiet(link, stop)
        finally:
            link.close()
    with _restart_if_it_fails(ports):
        if ports.console:
            interrupt(ports.console)
        yield ports


@contextlib.contextmanager
def _restart_if_it_fails(ports: Channels) -> Iterator[None]:
    try:
        yield
    except BaseException:
        if ports.console:
            with contextlib.suppress(MountError):
                reset(ports.console)
        raise


def _channels(drive: Drive) -> Channels:
    return channels(drive, list_ports.comports())


def _restart(ports: Channels, progress: Progress) -> float:
    """Restart the board, or ask the user to. Returns how long it may take to answer, in seconds."""
    if ports.console:
        progress.phase("restarting")
        reset(ports.console)
        return _BACK_S
    progress.phase("the files are on the drive; no console of this board is here: press its reset button now")
    return _BY_HAND_S


def interrupt(port: str) -> None:
    """Interrupt the program, whose `finally` turns the motors off, and wait for the prompt. Raises DeployError.

    At the prompt CircuitPython does not reload when the drive is written to. It stays there after the port is closed.
    """
    link = Link(open_port(port))
    try:
        end = time.monotonic() + _PROMPT_S
        while time.monotonic() < end:
            link.write(prompt.INTERRUPT)
            received = link.drain(_QUIET_S)
            # A second Ctrl-C at once would interrupt the program's `finally`. After the program any key opens the
            # prompt, and Ctrl-B leaves a raw prompt.
            for _ in range(_KEYS):
                link.write(b"\r" + prompt.FRIENDLY)
                received = received[-200:] + link.drain(_QUIET_S)
                if received.rstrip().endswith(prompt.SIGN):
                    return
    finally:
        link.close()
    raise DeployError(
        f"the program on the board does not stop for Ctrl-C on {port}: nothing was changed; press its reset button"
        " and try again"
    )


def reset(port: str) -> None:
    """Reset the board from its prompt, as its button does: a soft reset would not run boot.py."""
    link = Link(open_port(port))
    try:
        link.write(b"\r" + prompt.INTERRUPT + prompt.FRIENDLY)
        link.drain(_QUIET_S)
        link.write(b"import microcontroller\r")
        link.drain(_QUIET_S)
        link.write(b"microcontroller.reset()\r")
        link.drain(_QUIET_S)
    except ConnectionLost:
        pass  # the reset closes the port
    finally:
        link.close()


def last_words(port: str) -> str:
    """Run the program once more. Returns the last line of its error, or "". Raises DeployError."""
    interrupt(port)
    link = Link(open_port(port))
    try:
        link.write(prompt.RESTART)
        received = b""
        end = time.monotonic() + _START_S
        while not any(sign in received for sign in _ENDED) and time.monotonic() < end:
            received += link.drain(_QUIET_S, _LAST_WORDS_S)
    finally:
        link.close()
    text = received.decode("utf-8", "replace")
    said = [
        line.strip() for line in text.splitlines() if "Error" in line or line.startswith(("mirrormount", "mountfw:"))
    ]
    return printable(said[-1]) if said else ""


# ---- does it run?


def _already(drive: Drive, stop: bool, expected: tuple[str, ...]) -> str:
    """For a drive that needs no change: ask for the hash of what runs, and restart the board only if it differs."""
    with contextlib.suppress(NotSeenRunning):
        return _listen(drive, expected, 0.0)
    with _at_prompt(drive, stop) as ports:
        longest_s = _restart(ports, Progress())
    return _listen(drive, expected, longest_s)


def _listen(drive: Drive, expected: tuple[str, ...], longest_s: float) -> str:
    """Wait until the board answers XF? with one of the hashes. Returns "board, mountfw version, n axes, …".

    The board's ports disappear meanwhile and may return under other names. Raises FirmwareFailed with the board's own
    error if the firmware does not start, else NotSeenRunning.
    """
    end = time.monotonic() + longest_s
    why = "no port of it was seen"
    while True:
        if device := (ports := _channels(drive)).protocol:
            try:
                return _identity(device, expected)
            except (CannotOpen, ConnectionLost, NoAnswer, DeployError) as e:
                why = str(e)
        if time.monotonic() >= end:
            break
        time.sleep(_AGAIN_S)
    if longest_s and ports.console:
        said = ""
        with contextlib.suppress(MountError), _restart_if_it_fails(ports):
            said = last_words(ports.console)
        if said:
            raise FirmwareFailed(
                f"the firmware on the board does not start; it says: {said}; the new files are on the drive: deploy"
                " another version or another board file, or undeploy"
            )
    raise NotSeenRunning(
        "the files are on the drive and were read back as sent, but the board has not confirmed that it runs them"
        f" ({why}): press its reset button, then deploy again, which only asks"
    )


def _identity(device: str, expected: tuple[str, ...]) -> str:
    link = Link(open_port(device))
    try:
        link.drain(0.1)
        answer = ask(link, b"*IDN?\n")
        found = _IDENTITY.search(answer)  # on a console there may be other text before it
        if not found:
            raise DeployError(f"{device} says {answer.strip()[-60:]!r}" if answer.strip() else f"{device} is silent")
        axes, told = check(link, expected)
        what = "checksum (it has no SHA-256)" if told.startswith("crc32-") else "hash"
        who = printable(f"{found[1]}, mountfw {found[2]}")
        return f"{who}, {axes} axes, the board tells the {what} of what was sent"
    finally:
        link.close()
