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

import hashlib
import os
import shutil
import sys
from pathlib import Path
from typing import Callable, Iterable, List, NamedTuple, Optional, Sequence, Tuple

from _programs import OTHER_REMEDY, Command, Run, Stop, failure, run, say, show, venv_python

OLDEST = (3, 11)
KNOWN_MINORS = (14, 13, 12, 11)
MADE = "mirrormount-made"
INSTALLING = "mirrormount-installing"

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
