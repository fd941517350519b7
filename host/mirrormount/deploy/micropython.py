"""`mirrormount deploy` and `undeploy`: the firmware onto a MicroPython board, and off it.

A CircuitPython board has its own way, through its drive: circuitpython.py. Here the one or the other is chosen.

A deploy looks at the board (Mpremote.survey), decides what has to be done (plan), uploads the firmware into a folder
beside the one that runs (Mpremote.upload), verifies it there (Mpremote.verify), exchanges the two folders
(Mpremote.exchange) and waits for the new firmware's answer (try_it). on_board.py has the board's part of it, and says
why a power cut at any moment leaves one whole firmware.
"""

import ast
import contextlib
import dataclasses
import json
import os
import re
import subprocess
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from serial.tools import list_ports

from mirrormount.deploy import circuitpython, on_board, prompt
from mirrormount.deploy.firmware import (
    THIS,
    board_choice,
    check_board_file,
    check_choice,
    firmware,
    firmware_hash,
    folders,
    hashes,
    read_pins,
)
from mirrormount.deploy.prompt import STATUS, Options, StopAnswer, ask, check, may_replace, quiet, stop_answered
from mirrormount.errors import (
    CannotOpen,
    ConnectionLost,
    DeployError,
    FirmwareFailed,
    MountError,
    MpremoteError,
    NoAnswer,
    NoBoardFound,
    SeveralBoardsFound,
    WrongDrive,
)
from mirrormount.files import scratch_folder
from mirrormount.supported import MICROPYTHON, text
from mirrormount.terminal import Progress, Terminated, printable, python_module
from mirrormount.transport.discovery import (
    Drive,
    drive_at,
    find_bootloaders,
    find_drives,
    find_micropython,
    find_one,
    serial_number,
)
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_port
from mountfw import __version__

FLASH_IT = (
    "MicroPython goes on first: hold BOOTSEL while plugging in, then mirrormount flash; or drop the .uf2 for the board"
    " on the drive that appears (micropython.org/download)"
)
OR_CIRCUITPYTHON = "; or CircuitPython in the same way (circuitpython.org/downloads)"
_TO_BOOTLOADER = """
try:
    import machine

    machine.bootloader()
except ImportError:
    import microcontroller

    microcontroller.on_next_reset(microcontroller.RunMode.BOOTLOADER)
    microcontroller.reset()
"""
_SPARE_BLOCKS = 12  # that littlefs needs for the folders and for renames
_CALL_S = 300.0  # the longest that one call of mpremote may take
_BACK_S = 60.0  # how long a board may take to come back from its reset: about 1 s, an emulated one more
_AGAIN_S = 0.05  # between two tries to open a port that is to come back: no event shows that it has
_START_S = 15.0  # how long a firmware that fails may take to fail
_BANNER = re.compile(r"^(MicroPython |Type \"help|>>>|Adafruit CircuitPython )", re.MULTILINE)


def deploy(options: Options, progress: Progress | None = None) -> str:
    """Put the firmware on the board. Returns one line for the user.

    Raises DeployError, CannotOpen, ConnectionLost: the board then has what it had, or says so at the next boot.
    """
    progress = progress or Progress()
    this = chosen_board(options)
    if drive := choose(options):
        return circuitpython.deploy(drive, this, options, progress)
    port = _find(options.port)
    with stop_answered(port) as stop_answer:
        return _deploy(port, this, options, progress, stop_answer)


def _deploy(port: str, this: dict[str, bytes], options: Options, progress: Progress, stop_answer: StopAnswer) -> str:
    started = time.monotonic()
    progress.phase("looking at the board")
    board = Mpremote(port)
    _approach(port, options.stop, stop_answer)
    with board.reset_if_it_fails():
        there = board.survey()
        _check_version(there.version, progress)
        progress.phase("compiling")
        wanted = firmware(None if options.source else there.mpy) | this
        check_choice(options.board, {*wanted, *there.files})
        check_board_file(there.machine, {*wanted, *there.files})
        todo = plan(wanted, there, may_replace(options))
        _check_room(todo, there)
        if todo.nothing:
            board.reset()
        else:
            board.upload(todo, progress)
            board.verify(todo)
            board.exchange(todo)
    progress.phase("restarting")
    identity, axes = try_it(board, port, there, todo, progress)
    files = f"{len(wanted)} files ({len(wanted) - todo.changed} unchanged)"
    kept = f"; the main.py that was there is now {todo.backup}" if todo.backup else ""
    return f"OK: {identity}, {axes} axes, {files} in {time.monotonic() - started:.1f} s{kept}"


def undeploy(options: Options, progress: Progress | None = None) -> str:
    """Take off the board what deploy has put there, and nothing else. Returns one line for the user."""
    progress = progress or Progress()
    if drive := choose(options):
        return circuitpython.undeploy(drive, options, progress)
    port = _find(options.port)
    with stop_answered(port) as stop_answer:
        board = Mpremote(port)
        _approach(port, options.stop, stop_answer)
        with board.reset_if_it_fails():
            progress.phase("looking for what deploy has put there, to remove it")
            done = board.undeploy()
    if done["found"] != [True]:
        raise DeployError("this board has no firmware that deploy has put there: nothing was removed")
    back = f"; there again: {printable(', '.join(done['restored']))}" if done["restored"] else ""
    kept = f"; kept, because changed since: {printable(', '.join(done['kept']))}" if done["kept"] else ""
    return f"OK: {len(done['removed'])} files removed{back}{kept}"


# ---- which board, and may it be changed?


def choose(options: Options) -> Drive | None:
    """The CircuitPython drive that is meant, or None for a MicroPython board.

    Raises WrongDrive, SeveralBoardsFound.
    """
    if options.drive is not None:
        drive = drive_at(options.drive)
        named = _named(options.port) if options.port is not None else None
        if named is None:
            return drive
        if drive.uid and drive.uid != serial_number(named):
            raise WrongDrive(f"{drive} and {options.port} are not of one board: their serial numbers differ")
        return dataclasses.replace(drive, uid=serial_number(named))
    drives = find_drives()
    if options.port is not None:
        named = _named(options.port) if drives else None
        found = [d for d in drives if named is not None and d.uid and d.uid == serial_number(named)]
        if len(found) > 1:  # for instance a copy of the drive on a memory stick
            raise SeveralBoardsFound(
                f"several drives say that {options.port} is theirs, name one: "
                + ", ".join(f"--drive {drive}" for drive in found)
            )
        return found[0] if found else None
    others = [device for device, _ in find_micropython()] if drives else []
    if len(drives) + len(others) > 1:
        names = [*others, *(f"--drive {drive}" for drive in drives)]
        raise SeveralBoardsFound(f"several boards found, name one: {', '.join(names)}")
    return drives[0] if drives else None


def _named(address: str) -> Any:
    """The port of this name among the system's, or None."""
    port = os.path.realpath(address) if os.path.exists(address) else address
    return next((found for found in list_ports.comports() if found.device == port), None)


def chosen_board(options: Options) -> dict[str, bytes]:
    """The file boards/this.py that --board or --pins stands for, if there is one. Raises DeployError."""
    if options.board:
        if not options.board.isidentifier():
            raise DeployError(
                f"a board's name is that of its file, for instance pico, not '{printable(options.board)}'"
            )
        return {THIS: board_choice(options.board)}
    return {THIS: read_pins(options.pins)} if options.pins else {}


def _find(address: str | None) -> str:
    if address is None:
        try:
            return find_one()
        except NoBoardFound as e:
            loaders = "".join(f" The drive {drive} is a bootloader, not yet a board." for drive in find_bootloaders())
            raise NoBoardFound(f"no board found.{loaders} A new one shows no port: {FLASH_IT}{OR_CIRCUITPYTHON}") from e
    if "://" in address:
        raise DeployError(
            f"deploy and undeploy need a serial port, not {printable(address)}: mirrormount ports lists them"
        )
    return address


def _approach(port: str, stop: bool, stop_answer: StopAnswer) -> None:
    """See to it that a MicroPython is there and no motor moves. Sends no stop unless told to.

    Raises DeployError. The board is left at its prompt.
    """
    link = Link(open_port(port))
    try:
        stop_answer.asking(link)
        link.drain(0.1)
        heard = quiet(link, stop)
        answered = bool(STATUS.search(heard))
        stop_answer.found(at_rest=answered)
        with prompt.restarted_on_interruption(link):
            if not answered:
                heard += prompt.look(link)
                if "CircuitPython" in heard:
                    raise DeployError(
                        "this board runs CircuitPython, and its drive is not mounted here: mount it, or say --drive"
                    )
                if prompt.SIGN.decode() not in heard:
                    raise DeployError(f"no Python answers on this board. {FLASH_IT}")
            _check_prompt(link)
    finally:
        link.close()


def _check_prompt(link: Link) -> None:
    """Interrupt what runs, and see that the prompt takes programs. Raises DeployError; then the firmware goes on."""
    works, heard = prompt.takes_programs(link)
    if works:
        return
    if b"(virtual board)" in heard:
        raise DeployError("this virtual board has no MicroPython prompt: start it with --machine micropython")
    raise DeployError(
        "no MicroPython prompt comes at this port, so nothing was changed: a virtual board has one if it is started"
        " with --machine micropython; a CircuitPython board takes the firmware by its drive"
    )


def _check_version(found: tuple[int, int], progress: Progress) -> None:
    if MICROPYTHON.too_old(found):
        raise DeployError(
            f"this board runs MicroPython {text(found)}: {text(MICROPYTHON.lowest)} or later is needed; nothing was"
            f" changed. {FLASH_IT}"
        )
    if MICROPYTHON.untried(found):
        progress.phase(f"MicroPython {text(found)} is newer than any that was tried ({MICROPYTHON.span})")


# ---- what has to be done


@dataclass
class Survey:
    """What is on a board. Paths are from its root on."""

    files: dict[str, str] = field(default_factory=dict)  # {path: SHA-256} of mountfw/..., main.py and its copies
    sizes: dict[str, int] = field(default_factory=dict)  # {path: bytes} of these
    listed: dict[str, str] = field(default_factory=dict)  # {path: SHA-256} of what an earlier deploy has put there
    aside: dict[str, list[str]] = field(default_factory=dict)  # {path: [its copy, SHA-256]} of what it has put aside
    free_bytes: int = 0
    block_bytes: int = 1
    machine: str = ""
    version: tuple[int, int] = (0, 0)
    mpy: int | None = None  # the format of compiled files

    @property
    def main_is_ours(self) -> bool:
        """True if a deploy has put the main.py there."""
        return "main.py" in self.files and self.files["main.py"] == self.listed.get("main.py")


def read_survey(told: Iterable[list]) -> Survey:
    """What on_board.survey() has told. Raises DeployError for what it would not say."""
    there = Survey()
    for fact in told:
        match fact:
            case ["file", str(path), str(sha), int(size)]:
                there.files[path], there.sizes[path] = sha, size
            case ["listed", str(path), str(sha)]:
                there.listed[path] = sha
            case ["aside", str(path), [str(copied), str(sha)]]:
                there.aside[path] = [copied, sha]
            case ["room", int(free), int(block)] if block > 0:
                there.free_bytes, there.block_bytes = free, block
            case ["about", None | int() as mpy, str(machine), int(major), int(minor)]:
                there.mpy, there.machine, there.version = mpy, machine, (major, minor)
            case _:
                raise DeployError("what the board tells of its files makes no sense: nothing was changed")
    return there


@dataclass(frozen=True)
class Plan:
    """What a deploy has to do."""

    upload: dict[str, bytes]  # {path: content}
    unchanged: list[str]  # files in mountfw that stay: the board copies them into the new folder
    backup: str  # what the main.py that is there is copied to, or ""
    changed: int  # files of the firmware that are new or differ
    after: dict[str, str]  # {path: SHA-256} when it is done, in mountfw and main.py
    nothing: bool  # the board is as it should be


def plan(wanted: dict[str, bytes], there: Survey, may_replace: Callable[[dict[str, str]], bool]) -> Plan:
    """The plan that makes a board hold `wanted`.

    Files in mountfw that are neither wanted nor of an earlier deploy, or that somebody has changed since, stay, but
    for a .py or .mpy that would hide a wanted file or be hidden by it. may_replace is asked about a main.py that is
    not ours, {"main.py": name for its copy}. Raises DeployError.
    """
    backup = _copy_of_main(hashes(wanted)["main.py"], there, may_replace)
    aside = there.aside | ({"main.py": [backup, there.files["main.py"]]} if backup else {})
    ours = hashes(wanted)
    if THIS in there.listed and THIS in there.files:  # an earlier choice stays
        ours.setdefault(THIS, there.listed[THIS])
    manifest = {"version": __version__, "files": dict(sorted(ours.items()))} | ({"aside": aside} if aside else {})
    new = wanted | {on_board.MANIFEST: json.dumps(manifest, indent=1).encode()}
    gone = {_counterpart(path) for path in wanted}
    gone |= {path for path, sha in there.listed.items() if path not in ours and there.files.get(path) == sha}
    present = {path: sha for path, sha in there.files.items() if path.startswith(f"{on_board.FOLDER}/")}
    stays = {path: sha for path, sha in present.items() if path not in gone and not path.endswith(".new")}
    after = stays | hashes(new)
    upload = {path: content for path, content in new.items() if there.files.get(path) != after[path]}
    present["main.py"] = there.files.get("main.py", "")
    return Plan(
        upload,
        sorted(path for path in after if path not in upload and path != "main.py"),
        backup,
        len(upload.keys() & wanted.keys()),
        after,
        nothing=after == present,
    )


def _copy_of_main(wanted_main: str, there: Survey, may_replace: Callable[[dict[str, str]], bool]) -> str:
    """The name for a copy of somebody else's main.py, which may be there already; "" if the main.py is ours."""
    present = there.files.get("main.py")
    if present in (None, wanted_main) or there.main_is_ours:
        return ""
    number = 1
    while there.files.get(name := f"main.py.bak{number if number > 1 else ''}", present) != present:
        number += 1
    if not may_replace({"main.py": name}):
        raise DeployError(
            "the board has a main.py of somebody else: nothing was changed; to replace it (a copy stays"
            f" as {name}) say --replace-main"
        )
    return name


def _counterpart(path: str) -> str:
    stem, dot, suffix = path.rpartition(".")
    return stem + dot + ("py" if suffix == "mpy" else "mpy")


def _check_room(todo: Plan, there: Survey) -> None:
    """Raise DeployError unless the flash has room for the new firmware beside the present one."""
    if todo.nothing:
        return
    sizes = [*map(len, todo.upload.values()), *(there.sizes[path] for path in todo.unchanged)]
    sizes += [there.sizes["main.py"]] if "main.py" in there.sizes else []  # its copy
    block = there.block_bytes
    need = sum(-(-size // block) * block for size in sizes) + _SPARE_BLOCKS * block
    if need > there.free_bytes:
        raise DeployError(
            f"the board's flash is full: {need // 1024} KB are needed, for the new firmware is written beside the"
            f" present one; {there.free_bytes // 1024} KB are free"
        )


# ---- the board through mpremote


class Mpremote:
    """The board at a port, through mpremote: each call is a process, with as many commands as it can take."""

    def __init__(self, port: str) -> None:
        self._port = port

    def survey(self) -> Survey:
        """Finish what an earlier deploy has left, and look at the board."""
        about = "getattr(sys.implementation, '_mpy', None), getattr(sys.implementation, '_machine', '')"
        return read_survey(self._tell(f"import sys\nsurvey()\nsay('about', {about}, *sys.implementation.version[:2])"))

    def upload(self, todo: Plan, progress: Progress) -> None:
        """Write the new firmware beside the present one. Raises DeployError, with the board as it was."""
        progress.phase(f"uploading {len(todo.upload)} files")
        begun = 0

        def follow(line: str) -> None:
            """Follow mpremote's own lines, one for each file that it begins."""
            nonlocal begun
            if line.startswith("cp ") and begun < len(todo.upload):
                progress.bar(begun, len(todo.upload), list(todo.upload)[begun])
                begun += 1

        with scratch_folder() as scratch:
            steps = [["run", _script(scratch, f"prepare({folders(todo.after)!r}, {todo.unchanged!r})")]]
            for number, (path, content) in enumerate(todo.upload.items()):
                local = Path(scratch, str(number))
                local.write_bytes(content)
                steps.append(["fs", "cp", "-f", str(local), f":/{beside(path)}"])
            try:
                self._run(*steps, on_line=follow)
            except MpremoteError as e:
                raise DeployError(f"the upload failed ({e}); the board has the firmware that it had") from e
            finally:
                progress.end()

    def verify(self, todo: Plan) -> None:
        """Compare what the board reads from its flash with what it should have. Raises DeployError if it differs."""
        there = {path: sha for kind, path, sha, _ in self._tell("tell_new()") if kind == "file"}
        expected = {beside(path): sha for path, sha in todo.after.items() if path != "main.py" or path in todo.upload}
        if wrong := sorted(path for path in there.keys() | expected.keys() if there.get(path) != expected.get(path)):
            raise DeployError(f"damaged on the way: {printable(wrong[0])}; the board has the firmware that it had")

    def exchange(self, todo: Plan) -> None:
        """Put the new firmware in the place of the present one; the board restarts."""
        self._tell(f"exchange({todo.backup!r})\nsay('done')", ["reset"])

    def put_back(self, todo: Plan, there: Survey) -> None:
        """Undo exchange(); the board restarts."""
        self._tell(f"put_back({todo.backup!r}, {'main.py' in there.files})\nsay('done')", ["reset"])

    def undeploy(self) -> dict[str, list]:
        """See on_board.undeploy; the board restarts. {"removed", "kept", "restored": paths, "found": [bool]}."""
        done: dict[str, list] = {kind: [] for kind in ("removed", "kept", "restored", "found")}
        for kind, value in self._tell("undeploy()", ["reset"]):
            done[kind].append(value)
        return done

    def reset(self) -> None:
        """Restart the board."""
        self._run(["reset"])

    def start_bootloader(self) -> None:
        """Leave the board in its boot loader, MicroPython's or CircuitPython's; its port goes."""
        self._run(["exec", "--no-follow", _TO_BOOTLOADER])

    @contextlib.contextmanager
    def reset_if_it_fails(self) -> Iterator[None]:
        """If a deploy fails or is ended before the exchange: remove what it has written, and start the firmware."""
        try:
            yield
        except BaseException:
            with contextlib.suppress(MountError):
                self._tell("tidy()\nsay('done')")
            with contextlib.suppress(MountError):
                self.reset()
            raise

    @contextlib.contextmanager
    def reset_if_interrupted(self) -> Iterator[None]:
        """Start the firmware again when Ctrl-C or a signal ends this program within; for calls that end in a reset."""
        try:
            yield
        except (KeyboardInterrupt, Terminated):
            with contextlib.suppress(MountError):
                self.reset()
            raise

    def _tell(self, code: str, *more: list[str]) -> list[list]:
        """Run code after on_board.py, with all of the board's memory. Returns what it says."""
        lines: list[str] = []
        with scratch_folder() as scratch:
            self._run(["run", _script(scratch, code)], *more, on_line=lines.append, fresh=True)
        return read_told(lines)

    def _run(self, *steps: list[str], on_line: Callable[[str], None] = lambda _line: None, fresh: bool = False) -> None:
        """One call of mpremote with several commands. Raises MpremoteError.

        fresh: with a soft reset first, which runs no main.py and leaves the memory to our script.
        """
        command = python_module("mpremote", "connect", self._port, *([] if fresh else ["resume"]))
        for step in steps:
            command += [*step, "+"]
        environment = os.environ | {"PYTHONUNBUFFERED": "1", "PYTHONIOENCODING": "utf-8"}
        with subprocess.Popen(
            command[:-1],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            env=environment,
        ) as process:
            timer = threading.Timer(_CALL_S, process.kill)
            timer.start()
            last = ""
            try:
                assert process.stdout
                for line in process.stdout:
                    on_line(line.strip())
                    last = line.strip() or last
            except BaseException:
                process.terminate()  # its work is put in order by the next call, not by its end
                raise
            finally:
                timer.cancel()
        if process.returncode:
            raise MpremoteError(
                printable(last.removeprefix("mpremote: ")) or f"mpremote ended with {process.returncode}"
            )


def beside(path: str) -> str:
    """Where a file is written to before the exchange."""
    return on_board.NEW_MAIN if path == "main.py" else on_board.NEW + path.removeprefix(on_board.FOLDER)


def _script(folder: str, code: str) -> str:
    """The path of a script for the board: on_board.py, then code."""
    path = Path(folder, "script.py")
    path.write_text(f"{board_script()}\n{code}\n", encoding="utf-8")
    return str(path)


def board_script() -> str:
    """The text of on_board.py without comments and docstrings: a board has little memory."""
    tree = ast.parse(Path(on_board.__file__).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:]
    return ast.unparse(tree)


def read_told(lines: Iterable[str]) -> list[list]:
    """What on_board.say() has printed among these lines. Raises DeployError."""
    told = [line.removeprefix(on_board.MARK) for line in lines if line.startswith(on_board.MARK)]
    if not told:
        raise DeployError("mpremote ran, but the board told nothing: try again")
    try:
        return [json.loads(line) for line in told]
    except (ValueError, RecursionError):
        raise DeployError("what the board tells cannot be understood: try again") from None


# ---- the new firmware must answer


def try_it(board: Mpremote, port: str, there: Survey, todo: Plan, progress: Progress) -> tuple[str, int]:
    """Wait for what was deployed; when it does not answer, put back what was there before.

    Returns "board, mountfw version" and its number of axes. Raises FirmwareFailed.
    """
    try:
        return come_back(port, {firmware_hash(todo.after)})
    except DeployError as e:
        why = str(e)
    if todo.nothing:
        raise FirmwareFailed(f"{why}; nothing was changed by this deploy, so there is nothing to put back")
    progress.phase(f"{why}; putting back the files that were there")
    raise FirmwareFailed(f"{why}; {_put_back(board, port, there, todo)}")


def _put_back(board: Mpremote, port: str, there: Survey, todo: Plan) -> str:
    """Bring back the files, and tell what the board has now."""
    try:
        with board.reset_if_interrupted():
            board.put_back(todo, there)
    except DeployError as e:
        return f"the files that were there are kept on the board, but could not be put back ({e}): deploy again"
    if "main.py" not in there.files:
        return "it was taken off again: the board has no main.py, as before"
    if not there.main_is_ours:
        return "it was taken off again: the main.py that was there before is back"
    try:
        come_back(port, None)
    except DeployError as e:
        return f"the firmware that was there before is back, but does not answer either ({e})"
    return "the firmware that was there before is back and answers"


def come_back(port: str, wanted: Collection[str] | None) -> tuple[str, int]:
    """Wait for the board to answer as a mount again. Returns "board, mountfw version" and its number of axes.

    wanted: what XF? may answer; None: anything. Its port may go and come back meanwhile. Raises DeployError.
    """
    end = time.monotonic() + _BACK_S
    why = "does not answer"
    while time.monotonic() < end:
        try:
            link = Link(open_port(port))
        except CannotOpen:
            time.sleep(_AGAIN_S)
            continue
        try:
            link.drain(0.1)
            heard = ask(link, b"*IDN?\n")
            if heard.startswith("mirrormount,"):
                _, name, _, version = (heard.splitlines()[0] + ",,,").split(",")[:4]
                # that may be the answer to an earlier question, so ask another; an older firmware may not know it
                axes = check(link, wanted)[0] if wanted is not None else 0
                return printable(f"{name}, mountfw {version.strip()}"), axes
            if prompt.SIGN.decode() in heard:
                said = _last_words(link)
                if said is not None:
                    why = f"does not start; it says: {said}" if said else "does not start, and does not say why"
                    break
        except (ConnectionLost, NoAnswer):
            continue
        finally:
            link.close()
    raise DeployError(f"the firmware on the board {why}")


def _last_words(link: Link) -> str | None:
    """Start the program once more at a prompt, to read why it ends: the last line before the prompt that follows.

    None if no prompt follows: it may have started this time.
    """
    prompt.run_again(link)
    heard = b""
    end = time.monotonic() + _START_S
    while time.monotonic() < end:
        heard += link.drain(0.02, 0.2)
        started = heard.partition(b"soft reboot")[2]
        if started.rstrip().endswith(prompt.SIGN):
            told = _BANNER.split(started.decode("utf-8", "replace").replace("\r\n", "\n"))[0]
            lines = [line.strip() for line in told.splitlines() if line.strip()]
            return printable(lines[-1]) if lines else ""
        if not started and len(heard) > 1 << 16:
            return ""
    return None
