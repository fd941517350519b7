"""The firmware's files, as they are installed with the host."""

import importlib.resources
import shutil
from pathlib import Path

from mirrormount.virtual.wiring import ENCODERS, MORE_DRIVES

THIS = "mountfw/boards/this.py"


def firmware_folder() -> Path:
    """The folder that holds the installed `mountfw`."""
    return Path(str(importlib.resources.files("mountfw"))).parent


def new_files(root: Path) -> Path:
    """Make root a MicroPython board's file system with the firmware on it. Returns root."""
    ignore = shutil.ignore_patterns("__pycache__", "entry", "package.json", "py.typed", "circuitpython*.py")
    shutil.copytree(firmware_folder() / "mountfw", root / "mountfw", ignore=ignore)
    shutil.copy(firmware_folder() / "mountfw" / "entry" / "main.py", root / "main.py")
    return root


def firmware_with(root: Path, board: str) -> Path:
    """A copy of the firmware in root, with this text as its board file this.py. Returns root."""
    shutil.copytree(firmware_folder() / "mountfw", root / "mountfw", ignore=shutil.ignore_patterns("__pycache__"))
    (root / THIS).write_text(board, encoding="utf-8")
    return root


def board_text(board: str, axes: int, encoder: str | None) -> str | None:
    """The board file of a mount that is wired as wiring.py says, on the pins of the file `board`; None if that is it.

    axes: 2, or 4. encoder: a kind of encoder.KINDS, or None.
    """
    lines = [f"from mountfw.boards.{board} import *"]
    if encoder is not None:
        word = {"motor": "encoder", "shaft": "shaft"}[encoder]
        lines.append(f"from mountfw.boards import {board} as _board")
        lines += [f"AXIS_{motor[1]} = dict(_board.AXIS_{motor[1]}, {word}={pins})" for motor, pins in ENCODERS.items()]
    if axes > 2:
        pins = {name: number for number, name in MORE_DRIVES.items()}
        for motor in (3, 4):
            legs = ", ".join(f'"{leg}": {pins[f"m{motor}_{leg}"]}' for leg in ("en", "pos", "neg"))
            lines.append(f'AXIS_{motor} = {{{legs}, "stop_pos": None, "stop_neg": None}}')
    return "\n".join(lines) + "\n" if len(lines) > 1 else None
