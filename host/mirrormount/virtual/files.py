"""The firmware's files, as they are installed with the host."""

import importlib.resources
import shutil
from pathlib import Path


def firmware_folder() -> Path:
    """The folder that holds the installed `mountfw`."""
    return Path(str(importlib.resources.files("mountfw"))).parent


def new_files(root: Path) -> Path:
    """Make root a MicroPython board's file system with the firmware on it. Returns root."""
    ignore = shutil.ignore_patterns("__pycache__", "entry", "package.json", "py.typed", "circuitpython*.py")
    shutil.copytree(firmware_folder() / "mountfw", root / "mountfw", ignore=ignore)
    shutil.copy(firmware_folder() / "mountfw" / "entry" / "main.py", root / "main.py")
    return root
