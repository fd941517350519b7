"""What the scripts of tools/ share: start other programs, and tell a person how they ended.

Standard library only, and written so that Python 3.8 can read it, like _bootstrap.py.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Tuple

ROOT = Path(__file__).resolve().parent.parent
PROGRESS_S = 10.0  # between two lines about a command that prints nothing
END_S = 5.0  # that a program has after Ctrl-C

Command = List[str]
Run = Callable[[Command], Tuple[int, str]]

# What pip and others may say, and what to do about it; the first that fits is shown.
REMEDIES = {
    r"No space left|Errno 28|not enough space": "The disk is full: free some space and run this again.",
    r"(?i)certificate.verify.failed": "A certificate was refused: set PIP_CERT to your network's own.",
    r"DO NOT MATCH THE HASHES": "A download is not the locked one: run this again; report it if it recurs.",
    r"ConnectionError|NameResolutionError|ProxyError|Max retries|timed out|Could not find a version": (
        "The package index cannot be reached or lacks this: check the network, HTTPS_PROXY and PIP_INDEX_URL."
    ),
}
OTHER_REMEDY = "Run the same command again; if it fails in the same way, delete the folder .venv first."


class Stop(Exception):
    """A failure that is explained in its message, so that no traceback is needed."""


def say(text: str) -> None:
    """Print now: programs started afterwards write to the same place."""
    print(text, flush=True)


def guarded(main: Callable[[List[str]], int]) -> int:
    """Run a script's main(); whatever goes wrong ends in a message and an exit status, not a traceback."""
    try:
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(errors="replace")  # not every terminal has the dots of "making …"
        return main(sys.argv[1:])
    except Stop as stop:
        say(str(stop))
        return 1
    except KeyboardInterrupt:
        say("\nStopped; the same command carries on from here.")
        return 130
    except OSError as error:
        say(f"{error}. {explain(str(error))}")
        return 1


def explain(output: str, otherwise: str = OTHER_REMEDY) -> str:
    """One line of remedy for what pip, venv, uv, apt-get or the system said."""
    return next((remedy for signs, remedy in REMEDIES.items() if re.search(signs, output)), otherwise)


def failure(what: str, output: str, otherwise: str = OTHER_REMEDY) -> Stop:
    """What failed, the end of what it said, and what to do."""
    lines = [line.rstrip() for line in output.splitlines() if line.strip()]
    return Stop("\n  | ".join([f"{what} failed:", *lines[-12:]]) + "\n" + explain(output, otherwise))


# Running programs


def venv_python(venv: Path) -> Path:
    """Where a virtual environment keeps its Python."""
    return venv / "Scripts" / "python.exe" if os.name == "nt" else venv / "bin" / "python"


def child_env(**extra: str) -> Dict[str, str]:
    """The caller's environment, with its pip and proxy settings, as if .venv were active.

    PIP_USER would send packages to the home folder; PIP_REQUIRE_VIRTUALENV keeps pip off the system's Python.
    """
    env = dict(os.environ, VIRTUAL_ENV=str(ROOT / ".venv"), DEBIAN_FRONTEND="noninteractive")
    env.update(PIP_REQUIRE_VIRTUALENV="1", PIP_USER="0", PIP_NO_INPUT="1", PIP_DISABLE_PIP_VERSION_CHECK="1")
    env["PATH"] = os.pathsep.join([str(venv_python(ROOT / ".venv").parent), env.get("PATH", os.defpath)])
    env.update(extra)
    return env


def run(command: Command, last: bool = False) -> Tuple[int, str]:
    """Run a command in the repository, without input; its exit status and everything it printed.

    A command that takes long prints nothing meanwhile: a line every PROGRESS_S shows that it still runs.
    last: it gets the processor that nobody else wants (POSIX).
    """
    try:
        child = subprocess.Popen(
            [*(as_last() if last else []), *command],
            cwd=str(ROOT),
            env=child_env(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=last,
        )
    except OSError as error:  # no such program, or not one for this machine
        return 127, str(error)
    if last:
        leave_behind(child.pid)
        _behind.append(child)
    start = time.monotonic()
    while True:
        try:
            output = child.communicate(timeout=PROGRESS_S * (6 if last else 1))[0]  # what it is beside prints, too
            return status_of(child.returncode), output.decode("utf-8", "replace")
        except subprocess.TimeoutExpired:
            say(f"      {' '.join(command[1:4])} … {time.monotonic() - start:.0f} s")
        except KeyboardInterrupt:
            interrupt_behind()
            end(child)
            raise


def leave_behind(session: int) -> None:
    """Give the processes of a session what those of all other sessions leave.

    Linux shares the processors among sessions first (sched(7), autogroup): within one, no priority counts for another.
    """
    with contextlib.suppress(OSError):  # another system, or one that does not share them so
        Path(f"/proc/{session}/autogroup").write_text("19")


_behind: "List[subprocess.Popen[bytes]]" = []  # what run() has started to be last


def interrupt_behind() -> None:
    """End what run() has started to be last: it has a session of its own, which Ctrl-C does not reach."""
    for child in _behind:
        if child.poll() is None and hasattr(os, "killpg"):
            os.killpg(child.pid, signal.SIGINT)


class Beside(ThreadPoolExecutor):
    """A thread for what runs beside something else, one after the other. Ctrl-C ends all of it."""

    def __init__(self) -> None:
        super().__init__(1)

    def __exit__(self, kind: Any, value: Any, trace: Any) -> Optional[bool]:
        """Wait for its end; after Ctrl-C begin nothing more."""
        if kind is KeyboardInterrupt:
            self.shutdown(wait=False, cancel_futures=True)
            interrupt_behind()
        return super().__exit__(kind, value, trace)


def as_last() -> Command:
    """What stands before a command that waits for all others: on Linux it gives way at once, elsewhere it is nice."""
    for words in (["chrt", "--idle", "0"], ["nice", "-n", "19"]):
        program = shutil.which(words[0])
        if program:
            return [program, *words[1:]]
    return []


def end(child: "subprocess.Popen[bytes]") -> None:
    """Wait for a child that Ctrl-C has reached, too; after END_S it is killed."""
    try:
        child.wait(timeout=END_S)
    except (subprocess.TimeoutExpired, KeyboardInterrupt):
        child.kill()
        child.wait()


def status_of(returncode: int) -> int:
    """An exit status as a shell gives it: 128 and its number for a signal."""
    return returncode if returncode >= 0 else 128 - returncode


def show(command: Command, cwd: Optional[Path] = None, stdin: Optional[int] = None, **extra_env: str) -> int:
    """Run a command whose output goes to the terminal; after Ctrl-C it has END_S to tidy up."""
    child = subprocess.Popen(command, cwd=cwd, stdin=stdin, env=child_env(**extra_env))
    try:
        return status_of(child.wait())
    except KeyboardInterrupt:
        end(child)
        if child.returncode == 130:  # it has said so itself
            return 130
        raise


def show_quietly_ended(command: Command) -> int:
    """Like show(), without input; but its stderr comes after its end, and after Ctrl-C not at all.

    That is for Python programs that print a traceback there when Ctrl-C comes at the wrong moment.
    """
    with tempfile.TemporaryFile() as errors:
        child = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.DEVNULL, stderr=errors, env=child_env())
        try:
            status = child.wait()
        except KeyboardInterrupt:
            end(child)
            raise
        errors.seek(0)
        sys.stderr.write(errors.read().decode("utf-8", "replace"))
        sys.stderr.flush()
    return status_of(status)
