"""A virtual board whose board file has a third axis. The bench has two motors: the third axis's pins are probes."""

import shutil
from pathlib import Path

from mirrormount_sim.board import LockstepPort, Options, make_simulation
from mirrormount_sim.machines import firmware_folder, new_files

THIRD = {16: "m3_en", 17: "m3_pos", 18: "m3_neg"}
BOARD_FILE = """
from mountfw.boards.pico import *
AXIS_3 = {"en": 16, "pos": 17, "neg": 18, "stop_pos": 19, "stop_neg": None}
"""


def make_firmware(root: Path) -> None:
    """The firmware with that board file, in root/firmware."""
    shutil.copytree(firmware_folder() / "mountfw", root / "firmware" / "mountfw")
    (root / "firmware" / "mountfw" / "boards" / "this.py").write_text(BOARD_FILE)


def make_board_files(folder: Path) -> list[str]:
    """The files of a MicroPython board with that board file, in folder. Returns the options of its virtual board."""
    (new_files(folder) / "mountfw" / "boards" / "this.py").write_text(BOARD_FILE)
    return ["--machine", "micropython", "--files", str(folder)]


def switch_on(root: Path) -> LockstepPort:
    """The port of such a board that has just started; root/files outlives its power. make_firmware() comes first."""
    simulation = make_simulation(Options(files=root / "files", firmware=root / "firmware"))
    simulation.probes.update(THIRD)
    return LockstepPort(simulation)
