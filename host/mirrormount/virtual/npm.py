"""Installs the packages of a package-lock.json: to the byte (their SHA-512 is in it), and without running their scripts.

Several processes may ask for the same at once: each installs into a folder of its own, and the first one to be ready
gives it the name that all of them use.
"""

import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

from mirrormount.errors import EmulatorMissing
from mirrormount.virtual.image import cache, last_line

_LISTS = ("package.json", "package-lock.json")
OLDEST_NODE = 18


def node() -> str:
    """The path of Node. Raises EmulatorMissing if there is none, or too old a one."""
    found = shutil.which("node")
    if not found:
        raise EmulatorMissing(f"this needs Node.js {OLDEST_NODE} or newer, and there is no `node`")
    version = subprocess.run([found, "--version"], capture_output=True, text=True).stdout.strip()
    if not version.startswith("v") or int(version[1:].split(".")[0]) < OLDEST_NODE:
        raise EmulatorMissing(f"this needs Node.js {OLDEST_NODE} or newer; this is {version or '?'}")
    return found


def installed(source: Path, name: str, finish: Callable[[Path], None] = lambda _folder: None) -> Path:
    """A folder in the cache with the files of source and, in node_modules, the packages that its lock file lists.

    The folder belongs to this content of source: another content gets another one. finish(folder) is called once, on
    the new folder, before anybody else sees it. Raises EmulatorMissing.
    """
    files = sorted(file for file in source.iterdir() if file.suffix == ".mjs" or file.name in _LISTS)
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    ready = cache() / f"{name}-{digest.hexdigest()[:16]}"
    if ready.is_dir():
        return ready
    npm = shutil.which("npm")
    if not npm:
        raise EmulatorMissing("npm installs what this needs, and there is no `npm`")
    ready.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f"{name}-", dir=ready.parent) as scratch:
        folder = Path(scratch) / name
        folder.mkdir()
        for file in files:
            shutil.copyfile(file, folder / file.name)
        install = [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--silent"]
        run = subprocess.run(install, cwd=folder, capture_output=True, text=True)
        if run.returncode:
            said = last_line(run.stderr or run.stdout)
            raise EmulatorMissing(f"npm could not install what {source.name}/package-lock.json lists: {said}")
        finish(folder)
        try:
            folder.rename(ready)
        except OSError:
            if not ready.is_dir():  # nobody else was faster: something is wrong
                raise
    return ready
