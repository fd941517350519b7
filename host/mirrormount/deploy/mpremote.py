"""The board through mpremote: each call is a process of its own, with as many commands as it can take.

What runs on the board is the text of on_board.py and main.py's replay(); it tells lines of JSON.
"""

import ast
import contextlib
import importlib.resources
import json
import os
import subprocess
import threading
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path

from mirrormount.common.child_python import python_module
from mirrormount.common.errors import DeployError, MountError, MpremoteError
from mirrormount.common.printable import printable
from mirrormount.common.progress import Progress
from mirrormount.common.scratch import scratch_folder
from mirrormount.common.signals import Terminated
from mirrormount.deploy import on_board
from mirrormount.deploy.fileset import folders
from mirrormount.deploy.micropython_plan import Plan

_ABOUT = """told['mpy'] = getattr(sys.implementation, '_mpy', None)
told['machine'] = getattr(sys.implementation, '_machine', '')
told['version'] = list(sys.implementation.version[:2])"""
_LONGEST_LINE = 1 << 20  # characters; longer ones are taken in parts
_CALL_S = 300.0  # the longest that one call of mpremote may take


class Mpremote:
    """Calls of mpremote on one port."""

    def __init__(self, port: str) -> None:
        self._port = port

    def survey(self) -> dict:
        """See on_board.survey; and `mpy`, the format of compiled files (or None), `machine` and `version`."""
        told = self._tell(f"import sys\ntold = survey(replay)\n{_ABOUT}\nsay(told)", fresh=True)
        if not _is_survey(told):
            raise DeployError("what the board tells of its files makes no sense: nothing was changed")
        return told

    def install(self, todo: Plan, progress: Progress) -> None:
        """Upload, verify, commit, reset. Raises DeployError, with the board as it was."""
        if not todo.journal:
            self.reset()
            return
        with scratch_folder() as scratch:
            needed = folders(todo.after)
            steps = [["run", self._script(scratch, "prepare", f"make_folders({needed!r})")]]
            for number, (path, content) in enumerate(todo.upload.items()):
                local = Path(scratch) / str(number)
                local.write_bytes(content)
                steps.append(["fs", "cp", "-f", str(local), f":/{path}.new"])
            steps.append(["soft-reset"])  # the uploads have left the memory in pieces
            steps.append(["run", self._script(scratch, "commit", f"{commit_call(todo)}\nsay(True)")])
            uploading = _Uploading(progress, list(todo.upload))
            try:
                self._run(*steps, ["reset"], on_line=uploading.heard)
            except MpremoteError as e:
                self._clean(list(todo.verify), e)
            except BaseException:  # this program is ended: what it has uploaded goes, and the caller resets the board
                with contextlib.suppress(MountError):
                    self._remove_uploads(list(todo.verify))
                raise
            finally:
                progress.end()

    def undeploy(self) -> dict:
        """See on_board.undeploy; the board restarts."""
        return self._tell("say(undeploy(replay))", ["reset"], fresh=True)

    def forget(self) -> None:
        """See on_board.forget; the board restarts."""
        self._tell("forget()\nsay(True)", ["reset"], fresh=True)

    def revert(self) -> bool:
        """See on_board.revert; the board restarts."""
        return self._tell("say(revert(replay))", ["reset"], fresh=True) is True

    def reset(self) -> None:
        """Restart the board."""
        self._run(["reset"])

    @contextlib.contextmanager
    def reset_if_it_fails(self) -> Iterator[None]:
        """The firmware was interrupted to survey the board: start it again if the deploy fails or is ended."""
        try:
            yield
        except BaseException:
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

    def _clean(self, paths: list[str], why: MpremoteError) -> None:
        """After a failed upload. Raises DeployError."""
        try:
            self._remove_uploads(paths)
        except DeployError:
            raise DeployError(
                f"the upload failed ({why}); the firmware that was there is kept on the board: deploy again"
            ) from why
        raise DeployError(f"the upload failed ({why}); the board has the firmware that it had") from why

    def _remove_uploads(self, paths: list[str]) -> None:
        """Remove from the board what was uploaded for these paths; a commit that was begun is finished by replay()."""
        self._tell(f"clean({paths!r}, replay)\nsay(True)")

    def _tell(self, code: str, *more: list[str], fresh: bool = False):
        """Run code after the functions of on_board.py that it needs. Returns what it says."""
        said: list[str] = []
        with scratch_folder() as scratch:
            self._run(["run", self._script(scratch, "script", code)], *more, on_line=said.append, fresh=fresh)
        return read_told(said)

    def _script(self, folder: str, name: str, code: str) -> str:
        path = Path(folder) / f"{name}.py"
        path.write_text(f"{script_for(code)}\n{code}\n", encoding="utf-8")
        return str(path)

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
                for line in iter(partial(process.stdout.readline, _LONGEST_LINE), ""):
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


def read_told(lines: Iterable[str]):
    """What on_board.say() has printed among these lines. Raises DeployError."""
    told = [line.removeprefix(on_board.MARK) for line in lines if line.startswith(on_board.MARK)]
    if not told:
        raise DeployError("mpremote ran, but the board told nothing: try again")
    try:
        parts = [json.loads(line) for line in told]
    except (ValueError, RecursionError):
        raise DeployError("what the board tells cannot be understood: try again") from None
    if not all(isinstance(part, dict) for part in parts):
        return parts[0]
    whole: dict = {}
    for part in parts:
        for key, value in part.items():
            inner = whole.get(key)
            whole[key] = inner | value if isinstance(inner, dict) and isinstance(value, dict) else value
    return whole


def commit_call(todo: Plan, replay: str = "replay") -> str:
    """The call on the board that commits what was uploaded."""
    return f"commit({todo.verify!r}, {todo.backup!r}, {todo.journal!r}, {replay}, {todo.keep!r})"


def _is_survey(told: object) -> bool:
    """True if a board's survey has the form that it should have: what comes from a board is input."""
    if not isinstance(told, dict):
        return False
    texts = (told.get("files"), told.get("manifest"))
    sizes, asides = told.get("sizes"), told.get("aside")
    return (
        all(isinstance(part, dict) and all(isinstance(v, str) for v in part.values()) for part in texts)
        and isinstance(sizes, dict)
        and _are_whole(sizes.values())
        and isinstance(asides, dict)
        and all(isinstance(v, list) and len(v) == 2 and all(isinstance(x, str) for x in v) for v in asides.values())
        and isinstance(told.get("machine"), str)
        and all(isinstance(told.get(name), list) and len(told[name]) == 2 for name in ("room", "version"))
        and _are_whole([*told["room"], *told["version"]])
        and told["room"][1] > 0
        and (told.get("mpy") is None or _are_whole([told["mpy"]]))
    )


def _are_whole(numbers: Iterable[object]) -> bool:
    return all(type(number) is int and 0 <= number < 1 << 40 for number in numbers)


def script_for(code: str | None = None) -> str:
    """The text of on_board.py and of main.py's replay(); of their functions, those that code needs (None: all).

    A board has little memory: what is sent must not fill it.
    """
    tree = ast.parse(Path(on_board.__file__).read_text(encoding="utf-8") + "\n" + replay_source())
    if code is not None:
        functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
        needed: set[str] = set()
        names = _names(ast.parse(code))
        while names := (names & functions.keys()) - needed:
            needed |= names
            names = set[str]().union(*(_names(functions[name]) for name in names))
        tree.body = [node for node in tree.body if not isinstance(node, ast.FunctionDef) or node.name in needed]
    return _bare(tree)


def _names(tree: ast.AST) -> set[str]:
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}


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
