"""A MicroPython VM whose file system is a folder, for tests of deploy and undeploy; conftest.py has the fixtures."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from served import ServedBoard, run_cli

from mirrormount.device.mount import Mount

THEIRS = "print('a program of somebody else')\n"  # a main.py


def contents(root: Path) -> dict[str, bytes]:
    """Every file of a board."""
    return {p.relative_to(root).as_posix(): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def listed(root: Path) -> set[str]:
    """What the manifest says."""
    return set(json.loads((root / "mountfw" / "manifest.json").read_text())["files"])


class Served:
    """A served VM and its files."""

    def __init__(self, board: ServedBoard, root: Path) -> None:
        self.board = board
        self.root = root
        self.port = str(board.link)

    def deploy(self, *options: str) -> subprocess.CompletedProcess:
        return run_cli("deploy", self.port, *options)

    def run(self) -> None:
        """Let motor 1 run, and go away."""
        mount = Mount.open(self.port)
        mount.send("1XM60000;1MV+", keep_alive=False)
        mount.close()

    def ask(self, question: str) -> str:
        with Mount.open(self.port) as mount:
            return mount.ask(question)


def mpy_of_the_vm() -> int:
    """The VM's format of compiled files."""
    vm = shutil.which("micropython", path=os.path.dirname(sys.executable)) or shutil.which("micropython")
    if vm is None:
        pytest.skip("no MicroPython VM here")
    said = subprocess.run([vm, "-c", "import sys; print(sys.implementation._mpy)"], capture_output=True, check=True)
    return int(said.stdout)
