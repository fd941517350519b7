"""What kinds of virtual boards there are, and what of it goes together."""

from dataclasses import dataclass
from pathlib import Path

from mirrormount.common.errors import BadAddress
from mirrormount.virtual import machines
from mirrormount.virtual.bench import Order
from mirrormount.virtual.encoder import KINDS, OF_WIRES
from mirrormount.virtual.profile import SMOOTH, Profile

BENCHES = ("paper", "switches")
# the firmware's board files, and what MicroPython calls the boards
BOARDS = {"pico": machines.PICO, "pico_drv8833": "pico_drv8833"}
BOARD_IDS = {"pico": machines.PICO_ID, "pico_drv8833": "pico_drv8833"}  # what CircuitPython calls them


@dataclass(frozen=True)
class Options:
    """The kind of a virtual board. machine: see machines.py. files: its file system (default: a new one with the
    firmware on it; the cpython and circuitpython machines keep what they save there). image, flash and flash_cache
    are the rp2040 machine's. firmware: the folder that holds `mountfw` (those two; default: the installed one). axes:
    2, or 4 on the cpython machine. unit: gives a board of that machine a unique id of its own. encoder: a kind of
    encoder.KINDS on motors 1 and 2; orders: its faults; truth: a file that gets the screws' turns at each end of a
    motion. A folder of files that has something in it keeps its board file."""

    machine: str = "cpython"
    bench: str = "paper"
    board: str = "pico"
    seed: int = 1
    profile: Profile = SMOOTH
    axes: int = 2
    unit: int = 0
    encoder: str | None = None
    orders: tuple[Order, ...] = ()
    truth: Path | None = None
    edges: Path | None = None
    files: Path | None = None
    image: Path | None = None
    flash: Path | None = None
    flash_cache: bool = True
    firmware: Path | None = None

    def check(self) -> None:
        """Raises BadAddress for an unknown machine, bench or board, and for what does not go together."""
        for what, value, known in (
            ("machine", self.machine, machines.NAMES),
            ("bench", self.bench, BENCHES),
            ("virtual board", self.board, tuple(BOARDS)),
        ):
            if value not in known:
                raise BadAddress(f"there is no {what} {value!r}: choose one of {', '.join(known)}")
        if self.axes not in (2, 4) or (self.axes == 4 and (self.machine, self.board) != ("cpython", "pico")):
            raise BadAddress("a virtual board has two axes; with machine=cpython and board=pico it may have four")
        if self.encoder not in (None, *KINDS):
            raise BadAddress(f"there is no encoder {self.encoder!r}: choose one of {', '.join(KINDS)}")
        if self.encoder == "shaft" and any(order.name == "lost" for order in self.orders):
            raise BadAddress("encoder=shaft tells angles, and has no edges to lose: fault=lost is for encoder=motor")
        of_wires = [order.name for order in self.orders if order.name in OF_WIRES]
        if of_wires and not self.encoder:
            raise BadAddress(f"fault={of_wires[0]} is an encoder's, and none is fitted: encoder=motor or encoder=shaft")
        if self.machine == "rp2040" and self.board != "pico":
            raise BadAddress("the rp2040 machine is a Pico with an SN754410")
        for name, value in (("image", self.image), ("flash", self.flash)):
            if value is not None and self.machine != "rp2040":
                raise BadAddress(f"{name} is for the machine rp2040: the {self.machine} machine has none")
        if not self.flash_cache and self.machine != "rp2040":
            raise BadAddress(f"the cache of the flash is of the machine rp2040: the {self.machine} machine has none")
        if self.files is not None and self.machine == "rp2040":
            raise BadAddress("the rp2040 machine keeps its files in its flash: flash=FILE (--flash), not files")
