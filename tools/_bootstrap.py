"""What tools/demo.py and tools/test.py share: a Python that is new enough, .venv, and the locked packages in it.

Standard library only, and written so that Python 3.8 can read it: an old Python has to get as far as handing over to
a newer one.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Callable, List, Mapping, Optional, Sequence

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
PYTHON = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
IS_OLD = "import sys; sys.exit(sys.version_info < (3, 11))"
HAS_PIP = "import sys, pip; sys.exit(sys.prefix == sys.base_prefix)"
LOCKED = ("--no-deps", "--require-hashes", "-r")  # what a lock file names, in these versions and with these hashes only
OURSELVES = ("--no-deps", "--no-build-isolation", "-e", ".")  # built by what the lock has put into .venv
ADVICE = """\
mirrormount needs Python 3.11 or newer; this one is {}.{}, and there is no newer one on PATH. To get one:
  Debian 12+, Ubuntu 24.04+: sudo apt install python3 python3-venv  (Ubuntu 22.04: python3.11 python3.11-venv)
  Fedora: sudo dnf install python3    macOS: brew install python    Windows: winget install Python.Python.3.13"""


class Stop(Exception):
    """A failure that its message explains: no traceback is needed."""


def say(text: str) -> None:
    """Print now: programs that are started afterwards write to the same place."""
    print(text, flush=True)


def guarded(main: Callable[[List[str]], int]) -> int:
    """Run a script's main(); what goes wrong ends in one clear line and an exit status."""
    try:
        ensure_python()
        return main(sys.argv[1:])
    except KeyboardInterrupt:
        say("\nStopped; the same command carries on from here.")
        return 130
    except (Stop, OSError) as error:
        say(str(error))
        return 1


def call(
    command: Sequence[str],
    cwd: Optional[Path] = ROOT,
    stderr: Optional[int] = None,
    environment: Optional[Mapping[str, str]] = None,
) -> int:
    """Run a command in front of the person, as if .venv were active; its exit status, 127 if there is no such program.

    PIP_USER would send packages to the home folder. After Ctrl-C, which reaches the command too, its end is awaited.
    """
    env = dict(os.environ, VIRTUAL_ENV=str(VENV), PIP_USER="0", DEBIAN_FRONTEND="noninteractive", **(environment or {}))
    env["PATH"] = os.pathsep.join([str(PYTHON.parent), env.get("PATH", os.defpath)])
    try:
        child = subprocess.Popen(command, cwd=cwd, stdin=subprocess.DEVNULL, stderr=stderr, env=env)
    except OSError:
        return 127
    try:
        return child.wait()
    except KeyboardInterrupt:
        child.wait()
        raise


def works(python: Sequence[str], code: str) -> bool:
    """Whether this Python starts, and runs some code without an error."""
    return call([*python, "-c", code], stderr=subprocess.DEVNULL) == 0


def ensure_python() -> None:
    """Return if this Python is new enough; else start over with one that is, or say what to install."""
    if sys.version_info[:2] >= (3, 11):
        return
    for name in ("python3.14", "python3.13", "python3.12", "python3.11", "python3", "python", "py -3"):
        if works(name.split(), IS_OLD):
            sys.exit(call([*name.split(), *sys.argv], cwd=None))
    raise Stop(ADVICE.format(*sys.version_info))


def apt_install(packages: Sequence[str]) -> None:
    """Install packages of Debian and Ubuntu, as root or with sudo."""
    by_hand = "Please install by hand: sudo apt install " + " ".join(packages)
    apt = shutil.which("apt-get")
    if not apt:
        raise Stop("There is no apt-get here. " + by_hand)
    sudo = [] if os.geteuid() == 0 else ["sudo", "-E"]
    for words in (["update"], ["install", "-y", "--no-install-recommends", *packages]):
        if call([*sudo, apt, *words]):
            raise Stop(f"apt-get {words[0]} failed. {by_hand}")


def make_venv(may_install: bool) -> None:
    """Make .venv, unless one that works is there, be it of somebody else; or say why there is none."""
    if works([str(PYTHON)], HAS_PIP):
        if not works([str(PYTHON)], IS_OLD):
            raise Stop(".venv has a Python that is older than 3.11: delete or rename .venv and run this again.")
        return
    if VENV.exists() and not (VENV / "pyvenv.cfg").exists():  # it would be emptied
        raise Stop(".venv is no virtual environment: delete or rename it and run this again.")
    if importlib.util.find_spec("ensurepip") is None:  # Debian has it in a package of its own
        package = "python{}.{}-venv".format(*sys.version_info)
        if not may_install:
            raise Stop(f"This Python cannot make virtual environments yet. Run: sudo apt install {package}")
        apt_install([package])
    if call([sys.executable, "-I", "-m", "venv", "--clear", str(VENV)]):
        raise Stop("Making .venv failed. Is the disk full? If not, delete the folder .venv and run this again.")


def prepare(purpose: str, lock: str, may_install: bool = False) -> None:
    """Make .venv, and install what a lock file names and mirrormount itself, unless that was done before."""
    say("making .venv …")
    make_venv(may_install)
    say(f"installing packages for the {purpose} (the first time this takes some minutes) …")
    digest = hashlib.sha256(str(ROOT).encode())
    for name in (lock, "pyproject.toml", "firmware_py/mountfw/__init__.py"):
        digest.update((ROOT / name).read_bytes())
    stamp = VENV / f"mirrormount-{purpose}.stamp"  # of what is installed; written last
    if stamp.exists() and stamp.read_text() == digest.hexdigest():
        return
    for arguments in ((*LOCKED, lock), OURSELVES):
        if call([str(PYTHON), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *arguments]):
            raise Stop(
                "pip install failed. Check the network (HTTPS_PROXY, PIP_INDEX_URL, PIP_CERT) and that the disk has"
                " space, then run this again; if it fails in the same way, delete the folder .venv first."
            )
    stamp.write_text(digest.hexdigest())
