"""What tools/demo.py and tools/test.py share: find a Python, make .venv, put packages into it.

Standard library only, and written so that Python 3.8 can read it: an old Python has to get as far as handing
over to a newer one.  Functions that start programs take the function that does so (``run``), so that
tests/tools/test_bootstrap.py can stand in for pip, uv and apt-get.

Three kinds of file inside .venv say what state it is in:

* ``mirrormount-made``: we made this .venv, completely, for this folder (written last);
* ``mirrormount-installing``: pip was started and has not finished;
* ``mirrormount-<purpose>.stamp``: what pip installed, so that it need not be asked again.
"""

from __future__ import annotations

import contextlib
import hashlib
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
from typing import Any, Callable, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

ROOT = Path(__file__).resolve().parent.parent
OLDEST = (3, 11)
KNOWN_MINORS = (14, 13, 12, 11)
MADE = "mirrormount-made"
INSTALLING = "mirrormount-installing"
PROGRESS_S = 10.0  # between two lines about a command that prints nothing
END_S = 5.0  # that a program has after Ctrl-C

Command = List[str]
Run = Callable[[Command], Tuple[int, str]]
Which = Callable[[str], Optional[str]]

# Half-copied pips can be imported; only a finished one has the list of its files.
HEALTH_CHECK = (
    "import importlib.metadata, sys, pip; "
    "importlib.metadata.files('pip') and sys.prefix != sys.base_prefix or sys.exit(1); "
    "print('%d.%d.%d' % sys.version_info[:3])"
)

PYTHON_ADVICE = """\
mirrormount needs Python 3.11 or newer; this one is {found}, and there is no newer one on PATH. To get one:
  Debian 12+, Ubuntu 24.04+: sudo apt install python3 python3-venv  (Ubuntu 22.04: python3.11 python3.11-venv)
  Fedora:                    sudo dnf install python3
  macOS:                     brew install python
  Windows:                   winget install Python.Python.3.13"""

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


# Running programs


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


def explain(output: str, otherwise: str = OTHER_REMEDY) -> str:
    """One line of remedy for what pip, venv, uv, apt-get or the system said."""
    return next((remedy for signs, remedy in REMEDIES.items() if re.search(signs, output)), otherwise)


def failure(what: str, output: str, otherwise: str = OTHER_REMEDY) -> Stop:
    """What failed, the end of what it said, and what to do."""
    lines = [line.rstrip() for line in output.splitlines() if line.strip()]
    return Stop("\n  | ".join([f"{what} failed:", *lines[-12:]]) + "\n" + explain(output, otherwise))


# A Python that is new enough


def candidates(which: Which = shutil.which) -> List[Command]:
    """Commands that may start a newer Python than the one that is running, best first."""
    names = [f"python3.{minor}" for minor in KNOWN_MINORS] + ["python3", "python"]
    commands = [[path] for path in map(which, names) if path]
    launcher = which("py")
    if launcher:
        commands += [[launcher, f"-3.{minor}"] for minor in KNOWN_MINORS]
    return commands


def version_of(command: Command, run: Run = run) -> Tuple[int, ...]:
    """The version a command really starts; () for a stand-in that starts none (pyenv, the Windows store)."""
    status, output = run([*command, "-c", "import sys; print('%d %d' % sys.version_info[:2])"])
    words = output.split()
    return tuple(map(int, words)) if status == 0 and all(word.isdigit() for word in words) else ()


def find_python(commands: Iterable[Command], version: Callable[[Command], Tuple[int, ...]]) -> Optional[Command]:
    """The first command that starts a Python this project can use."""
    return next((command for command in commands if version(command) >= OLDEST), None)


def ensure_python(script: str, arguments: List[str]) -> None:
    """Return if this Python is new enough; otherwise start over with one that is, or say what to install."""
    if sys.version_info[:2] >= OLDEST:
        return
    command = find_python(candidates(), version_of)
    if command is None:
        raise Stop(PYTHON_ADVICE.format(found="{}.{}".format(*sys.version_info[:2])))
    command = [*command, os.path.abspath(script), *arguments]
    if os.name == "nt":  # there, exec would return to the prompt while the new program still runs
        sys.exit(show(command))
    os.execv(command[0], command)


def base_python() -> str:
    """The Python outside any virtual environment: the running one may live in the .venv we are to remove."""
    base = getattr(sys, "_base_executable", None) or sys.executable
    return base if os.path.exists(base) else os.path.realpath(sys.executable)


# The virtual environment


def venv_python(venv: Path) -> Path:
    """Where a virtual environment keeps its Python."""
    return venv / "Scripts" / "python.exe" if os.name == "nt" else venv / "bin" / "python"


def read(path: Path) -> str:
    """A small file's text; '' if there is none."""
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def look_at(venv: Path, run: Run) -> Tuple[str, str]:
    """The Python version of a .venv that can be used; or '' and why it cannot."""
    made_for = read(venv / MADE)
    if made_for and made_for != str(venv):
        return "", "was made for another folder"
    if made_for and (venv / INSTALLING).exists():
        return "", "was left half filled"
    status, output = run([str(venv_python(venv)), "-c", HEALTH_CHECK])
    if status:
        return "", "does not work" if made_for else "is half made"
    return output.split()[-1], ""


def remove(venv: Path) -> None:
    """Remove .venv; if it is a link, only the link."""
    if venv.is_symlink() or venv.is_file():
        venv.unlink()
    else:
        shutil.rmtree(str(venv))


def ensure_venv(venv: Path, run: Run, may_install: bool = False) -> str:
    """Make .venv unless a working one is there; its Python version.

    One that somebody else made is used as it is; only one that does not work is removed.
    """
    version, trouble = look_at(venv, run)
    if version and tuple(map(int, version.split(".")))[:2] < OLDEST:
        raise Stop(f".venv holds Python {version}; 3.11 is needed: delete or rename .venv and run this again.")
    if version:
        own = (venv / MADE).exists()
        say("      .venv is there" if own else "      .venv was not made by this script, but works: using it")
        return version
    if os.path.lexists(str(venv)):
        say(f"      .venv {trouble}: making it again")
        remove(venv)
    create_venv(venv, run, may_install)
    version, trouble = look_at(venv, run)
    if not version:
        raise Stop(f"The new .venv {trouble}. {OTHER_REMEDY}")
    (venv / MADE).write_text(str(venv), encoding="utf-8")
    return version


def create_venv(venv: Path, run: Run, may_install: bool, which: Which = shutil.which) -> None:
    """Make .venv with Python's own venv; where Debian has left that out, with uv or after installing it."""
    base = base_python()
    command = [base, "-m", "venv", str(venv)]
    if run([base, "-c", "import ensurepip, venv"])[0]:
        package = "python{}.{}-venv".format(*sys.version_info)
        uv = which("uv")
        if uv:
            command = [uv, "venv", "--seed", "--python", base, str(venv)]
        elif may_install:
            say(f"      installing {package} …")
            apt_install([package], run, which)
        else:
            raise Stop(f"This Python cannot make virtual environments yet. Run: sudo apt install {package}")
    status, output = run(command)
    if status:
        raise failure("Making .venv", output, "Is the disk full? If not, delete the folder .venv and run this again.")


def apt_install(packages: Sequence[str], run: Run, which: Which = shutil.which) -> None:
    """Install system packages, as root or with sudo."""
    apt = which("apt-get")
    sudo = None if getattr(os, "geteuid", int)() == 0 else which("sudo")
    if not apt:
        raise Stop("There is no apt-get here. Please install what Debian calls " + " ".join(packages))
    by_hand = "Please install by hand: sudo apt install " + " ".join(packages)
    prefix = [sudo, "-E", apt] if sudo else [apt]
    for words in (["update"], ["install", "-y", "--no-install-recommends", *packages]):
        status, output = run([*prefix, *words])
        if status:
            raise failure("apt-get " + " ".join(words), output, by_hand)


# The packages in it


OURSELVES = ("--no-deps", "--no-build-isolation", "-e", ".")  # built by what the lock has put into .venv


def locked(lock: str) -> List[Sequence[str]]:
    """Arguments of pip for what a lock file names, at these versions and with these hashes only."""
    return [("--no-deps", "--require-hashes", "-r", lock)]


class Wanted(NamedTuple):
    """What one script needs in .venv."""

    purpose: str
    pip_arguments: Sequence[Sequence[str]]  # of one `pip install` each
    files: Sequence[str]  # if one of these changes, pip is asked again
    modules: Sequence[str]  # imported to see that they are there


def stamp_text(root: Path, wanted: Wanted, version: str) -> str:
    """One line that changes whenever pip has to be asked again."""
    digest = hashlib.sha256(repr((str(root), version, wanted)).encode())
    for name in wanted.files:
        digest.update((root / name).read_bytes())
    return digest.hexdigest()


def prepare(root: Path, wanted: Wanted, steps: int, may_install: bool = False, run: Run = run) -> None:
    """Steps 1 and 2 of both scripts: .venv is there, and what is wanted is in it."""
    venv = root / ".venv"
    say(f"[1/{steps}] making .venv …")
    version = ensure_venv(venv, run, may_install)
    say(f"[2/{steps}] installing packages for the {wanted.purpose} …")
    stamp = venv / f"mirrormount-{wanted.purpose}.stamp"
    text = stamp_text(root, wanted, version)
    if read(stamp) == text and not (venv / INSTALLING).exists():
        if imports_work(venv, wanted, run):
            say("      nothing has changed since the last time")
            return
        (venv / INSTALLING).touch()  # it is damaged; if it is ours, this note has it made again
        ensure_venv(venv, run, may_install)
    (venv / INSTALLING).touch()
    stamp.write_text("", encoding="utf-8")
    for arguments in wanted.pip_arguments:
        status, output = run([str(venv_python(venv)), "-m", "pip", "install", *arguments])
        if status:
            raise failure("pip install " + " ".join(arguments), output)
    if not imports_work(venv, wanted, run):
        raise Stop(f"Some of {', '.join(wanted.modules)} cannot be imported. {OTHER_REMEDY}")
    stamp.write_text(text, encoding="utf-8")
    (venv / INSTALLING).unlink()


def imports_work(venv: Path, wanted: Wanted, run: Run) -> bool:
    """Whether what pip installed can be imported; mirrormount, which may be in work, need only be found."""
    code = f"import sys, importlib.util, {', '.join(wanted.modules)}\n"
    code += "importlib.util.find_spec('mirrormount') or sys.exit(1)"
    return run([str(venv_python(venv)), "-c", code])[0] == 0
