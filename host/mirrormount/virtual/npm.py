"""Node, and the packages of a package-lock.json: to the byte (it has their SHA-512), and no script of theirs runs."""

import shutil
import subprocess
from pathlib import Path

from mirrormount.common.errors import EmulatorMissing
from mirrormount.virtual.image import last_line

_OLDEST_NODE = 18  # that rp2040js runs on


def node() -> str:
    """The path of Node. Raises EmulatorMissing if it is missing or too old."""
    found = shutil.which("node")
    if not found:
        raise EmulatorMissing(f"the rp2040 machine needs Node.js {_OLDEST_NODE} or newer, and there is no `node`")
    version = subprocess.run([found, "--version"], capture_output=True, text=True).stdout.strip()
    if not version.startswith("v") or int(version[1:].split(".")[0]) < _OLDEST_NODE:
        raise EmulatorMissing(f"the rp2040 machine needs Node.js {_OLDEST_NODE} or newer; this is {version or '?'}")
    return found


def install(source: Path, folder: Path) -> bool:
    """Put the .mjs files of source into folder, and what its lock file lists into folder/node_modules.

    True if the packages were installed anew; False if those of this lock file were there. The caller sees to it that
    nobody else does the same at once (image.held). Raises EmulatorMissing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for file in [*source.glob("*.mjs"), source / "package.json", source / "package-lock.json"]:
        if not (folder / file.name).exists() or (folder / file.name).read_bytes() != file.read_bytes():
            shutil.copyfile(file, folder / file.name)
    lock = (source / "package-lock.json").read_bytes()
    stamp = folder / "node_modules" / ".lock-that-was-installed"
    if stamp.exists() and stamp.read_bytes() == lock:
        return False
    npm = shutil.which("npm")
    if not npm:
        raise EmulatorMissing("the rp2040 machine needs npm to install rp2040js, and there is no `npm`")
    command = [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--silent"]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if run.returncode:
        said = last_line(run.stderr or run.stdout)
        raise EmulatorMissing(f"npm could not install what {source.name}/package-lock.json lists: {said}")
    stamp.write_bytes(lock)
    return True
