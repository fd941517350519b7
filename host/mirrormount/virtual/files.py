"""The firmware's files, as they are installed with the host."""

import importlib.resources
import shutil
from pathlib import Path

from mirrormount.virtual.wiring import MORE_DRIVES


def firmware_folder() -> Path:
    """The folder that holds the installed `mountfw`."""
    return Path(str(importlib.resources.files("mountfw"))).parent


def new_files(root: Path) -> Path:
    """Make root a MicroPython board's file system with the firmware on it. Returns root."""
    ignore = shutil.ignore_patterns("__pycache__", "entry", "package.json", "py.typed", "circuitpython*.py")
    shutil.copytree(firmware_folder() / "mountfw", root / "mountfw", ignore=ignore)
    shutil.copy(firmware_folder() / "mountfw" / "entry" / "main.py", root / "main.py")
    return root


def four_axes_firmware(root: Path) -> Path:
    """A copy of the firmware in root, with a board file for four axes, wired as wiring.py says. Returns root."""
    shutil.copytree(firmware_folder() / "mountfw", root / "mountfw", ignore=shutil.ignore_patterns("__pycache__"))
    pins = {name: number for number, name in MORE_DRIVES.items()}
    lines = ["from mountfw.boards.pico import *"]
    for motor in (3, 4):
        legs = ", ".join(f'"{leg}": {pins[f"m{motor}_{leg}"]}' for leg in ("en", "pos", "neg"))
        lines.append(f'AXIS_{motor} = {{{legs}, "stop_pos": None, "stop_neg": None}}')
    (root / "mountfw" / "boards" / "this.py").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return root
