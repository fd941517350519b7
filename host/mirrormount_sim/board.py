"""Virtual boards: their options, and what opens one as `virtual://`, in this process and on every system.

virtual://                      in real time, as a real board would behave
virtual://?speed=max            in lockstep with the caller: fast, exact, the same every time
…&machine=cpython|micropython|rp2040|circuitpython  &bench=paper|switches  &board=pico|pico_drv8833
…&profile=smooth|rough|hardware  &seed=N  &supply=VOLTAGE, of the nominal one  &axes=2|4
…&encoder=motor|shaft  &fault=NAME[@SECONDS],…  &truth=FILE  &emi=0|1 (1: motors that start disturb the USB cable)
…&edges=FILE  &files=FOLDER  &image=FILE  &flash=FILE
"""

import contextlib
import math
import re
import socket
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO
from urllib.parse import parse_qsl

from mirrormount.errors import BadAddress, BadValue, CannotOpen, ConnectionLost, MountError
from mirrormount.terminal import printable
from mirrormount.transport.ports import SocketPort
from mirrormount.values import did_you_mean, digits, typed_number
from mirrormount_sim import MACHINES, emulator, machines
from mirrormount_sim.bench import Bench, Order
from mirrormount_sim.clocks import Lockstep, serve
from mirrormount_sim.emulator import is_circuitpython
from mirrormount_sim.machines import THIS, board_text, firmware_with, new_files
from mirrormount_sim.mechanics import FAULTS, KINDS, OF_WIRES
from mirrormount_sim.ports import PairPort
from mirrormount_sim.profiles import PROFILES, SMOOTH, Profile
from mirrormount_sim.simulation import START_US, BoardGone, Interference, Simulation
from mirrormount_sim.truth import Truth

BENCHES = ("paper", "switches")
# the firmware's board files, and what MicroPython calls the boards
BOARDS = {"pico": machines.PICO, "pico_drv8833": "pico_drv8833"}
BOARD_IDS = {"pico": machines.PICO_ID, "pico_drv8833": "pico_drv8833"}  # what CircuitPython calls them
LEAST_SUPPLY, MOST_SUPPLY = 0.3, 1.5  # of the nominal voltage: below, a gearmotor stands still
_MOST_SEED = (1 << 32) - 1
_MOST_FAULT_S = 1e6
_CIRCUITPYTHON_US = 6_000_000  # until the firmware is ready on it; its LED shows other things before that
Run = Callable[[int, Callable[[], bool]], object]


# ---- options


@dataclass(frozen=True)
class Options:
    """The kind of a virtual board. machine: see machines.py. files: its file system (default: a new one with the
    firmware on it; the cpython and circuitpython machines keep what they save there). image, flash and flash_cache
    (False: all of the flash is as fast as RAM) are the rp2040 machine's. firmware: the folder that holds `mountfw`
    (cpython, circuitpython; default: the installed one). axes: 2, or 4 on the cpython machine. unit: gives a board of
    that machine a unique id of its own. encoder: a kind of mechanics.KINDS on motors 1 and 2; orders: its faults;
    truth: a file that gets the screws' turns at each end of a motion. emi: motors that start disturb the USB cable. A
    folder of files that has something in it keeps its board file."""

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
    emi: bool = False

    def check(self) -> None:
        """Raises BadAddress for an unknown machine, bench or board, and for what does not go together."""
        for what, value, known in (
            ("machine", self.machine, MACHINES),
            ("bench", self.bench, BENCHES),
            ("virtual board", self.board, tuple(BOARDS)),
            ("encoder", self.encoder, KINDS),
        ):
            if value is not None and value not in known:
                raise _no_such(what, value, known)
        if self.axes not in (2, 4) or (self.axes == 4 and (self.machine, self.board) != ("cpython", "pico")):
            raise BadAddress("a virtual board has two axes; with machine=cpython and board=pico it may have four")
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
        if self.files is not None and self.machine == "rp2040":
            raise BadAddress("the rp2040 machine keeps its files in its flash: flash=FILE (--flash), not files")


def _no_such(what: str, name: str, known: Iterable[str]) -> BadAddress:
    return BadAddress(f"there is no {what} {name!r}: choose one of {', '.join(known)}{did_you_mean(name, known)}")


def profile_named(name: str, supply: str | None = None) -> Profile:
    """The profile of that name, with the supply that a person has typed. Raises BadAddress."""
    if name not in PROFILES:
        raise _no_such("profile", name, PROFILES)
    profile = PROFILES[name]
    if supply is None:
        return profile
    try:
        value = typed_number(supply, "supply")
    except ValueError:
        value = math.nan
    if not LEAST_SUPPLY <= value <= MOST_SUPPLY:
        raise BadAddress(f"supply is within {LEAST_SUPPLY} … {MOST_SUPPLY} of the nominal voltage, not {supply[:80]!r}")
    return replace(profile, supply=value)


def seed_of(text: str) -> int:
    """The seed that a person has typed. Raises BadAddress."""
    try:
        return digits(text, _MOST_SEED)
    except BadValue:
        raise BadAddress(f"a seed is a number, 0 to {_MOST_SEED}, not {text[:80]!r}") from None


def orders_of(text: str) -> tuple[Order, ...]:
    """The faults that a person has ordered, NAME@SECONDS after commas, of m1 and m2 unless one is named: m1:NAME.

    Raises BadAddress.
    """
    orders: list[Order] = []
    for word in filter(None, text.split(",")):
        motor, _, rest = word.rpartition(":")
        name, at, seconds = rest.partition("@")
        try:
            begins_s = typed_number(seconds, "a fault's time") if at else 0.0
        except ValueError:
            begins_s = math.nan
        if name not in FAULTS or motor not in ("", "m1", "m2") or not 0 <= begins_s <= _MOST_FAULT_S:
            raise BadAddress(
                f"a fault is one of {', '.join(FAULTS)}, as in fault=broken, fault=broken@5 (after 5 s) or"
                f" fault=m1:broken@5, not {word[:80]!r}{did_you_mean(name, FAULTS)}"
            )
        orders += [Order(name, which, round(begins_s * 1e6)) for which in ([motor] if motor else ["m1", "m2"])]
    return tuple(orders)


# ---- the board


def make_simulation(options: Options | None = None, bench: Bench | None = None) -> Simulation:
    """A virtual board that has just been switched on. Raises BadAddress, EmulatorMissing, CannotOpen.

    bench: one that exists, on which a board of the cpython machine is switched on again (default: a new one).
    """
    options = options or Options()
    options.check()
    start_us = bench.us if bench else START_US
    scratch: list[tempfile.TemporaryDirectory] = []
    board = board_text(options.board, options.axes, options.encoder)
    if options.machine == "rp2040":
        # with the model CircuitPython never comes to its drive in the emulator: why was not found
        model = options.flash_cache and not (options.image and is_circuitpython(options.image))
        command = emulator.command(options.image, options.flash, board, flash_cache=model)
    else:
        files = _files(options, board, scratch)
        firmware = options.firmware
        if board is not None and options.machine != "micropython" and firmware is None:
            copy = tempfile.TemporaryDirectory(prefix="mirrormount-")
            scratch.append(copy)
            firmware = firmware_with(Path(copy.name), board)
        if options.machine == "cpython":
            command = machines.cpython(files, BOARDS[options.board], firmware, options.unit, start_us)
        elif options.machine == "circuitpython":
            command = machines.circuitpython(files, BOARD_IDS[options.board], firmware)
        else:
            command = machines.micropython(files, BOARDS[options.board])
    try:
        file, truth = _records(options)
    except BadAddress:
        for folder in scratch:
            folder.cleanup()
        raise
    bench = bench or Bench(
        switches=options.bench == "switches",
        two_pwm=options.board == "pico_drv8833",
        seed=options.seed,
        profile=options.profile,
        axes=options.axes,
        encoder=options.encoder,
        orders=[replace(order, us=START_US + order.us) for order in options.orders],
    )
    emulated = options.machine == "rp2040"
    simulation = Simulation(
        command,
        bench,
        edges=file,
        truth=truth,
        scratch=scratch,
        start_us=start_us,
        quiet=emulated,
        interference=Interference(options.seed) if options.emi else None,
    )
    try:
        if emulated:  # a real image starts slowly: in lockstep, not in real time
            board = Lockstep(simulation)
            if options.image and is_circuitpython(options.image):
                board.run(_CIRCUITPYTHON_US)
            else:
                board.boot()
    except BaseException as e:  # Ctrl-C, too
        simulation.close()
        if isinstance(e, BoardGone):
            why = e.why or f": {options.image or 'its image'} does not run on it"
            raise CannotOpen(f"the virtual board has ended at its start{why}") from None
        raise
    return simulation


def _records(options: Options) -> tuple[IO[str] | None, Truth | None]:
    """The files of pin edges and of the truth, as far as they are asked for. Raises BadAddress."""
    try:
        file = options.edges.open("w", encoding="utf-8") if options.edges else None
    except OSError as e:
        raise BadAddress(f"cannot write pin edges to {options.edges}: {e.strerror}") from e
    try:
        return file, Truth(options.truth, START_US) if options.truth else None
    except BadAddress:
        if file:
            file.close()
        raise


def _files(options: Options, board: str | None, scratch: list[tempfile.TemporaryDirectory]) -> Path:
    """The folder of a board's files; with the firmware and this board file in it, if the machine has it there."""
    if options.files is None:
        scratch.append(tempfile.TemporaryDirectory(prefix="mirrormount-"))
        files = Path(scratch[0].name)
        if options.machine == "micropython":
            new_files(files)
            if board is not None:
                (files / THIS).write_text(board, encoding="utf-8")
        return files
    files = options.files.absolute()
    try:
        files.mkdir(parents=True, exist_ok=True)
    except OSError as e:  # FileExistsError: it is there and no folder
        why = "it is not a folder" if isinstance(e, FileExistsError) else e.strerror
        raise BadAddress(f"cannot use {options.files} for the board's files: {why}") from e
    return files


# ---- ports

_OPTIONS = (
    "speed=1|max, machine=, bench=, board=, profile=, seed=NUMBER, supply=, axes=2|4, encoder=motor|shaft, fault=,"
    " truth=, edges=, files=, image=, flash=, emi=0|1"
)


def wrong_option(url: str, options: str, unknown: Iterable[str]) -> BadAddress:
    """The error of an address with another option than these, or with one that has another value."""
    meant = "".join(did_you_mean(word, re.findall(r"(\w+)=", options)) for word in unknown)
    return BadAddress(f"{printable(url)}: options are {options}{meant}")


def open_virtual(url: str) -> "RealtimePort | LockstepPort":
    """A port (mirrormount.transport.ports) on a new virtual board. Raises BadAddress for an option it has not."""
    given = dict(parse_qsl(url.removeprefix("virtual://").removeprefix("?"), keep_blank_values=True))
    speed = given.pop("speed", "1")
    texts = {name: given.pop(name) for name in ("machine", "bench", "board") if name in given}
    paths = {name: Path(given.pop(name)) for name in ("edges", "files", "image", "flash", "truth") if name in given}
    profile = profile_named(given.pop("profile", SMOOTH.name), given.pop("supply", None))
    seed, axes = seed_of(given.pop("seed", "1")), given.pop("axes", "2")
    encoder = given.pop("encoder", None)
    orders, emi = orders_of(given.pop("fault", "")), given.pop("emi", "0")
    if given or speed not in ("1", "max") or axes not in ("2", "4") or emi not in ("0", "1"):
        raise wrong_option(url, _OPTIONS, given)
    options = Options(seed=seed, profile=profile, axes=int(axes), encoder=encoder, orders=orders, emi=emi == "1")
    simulation = make_simulation(replace(options, **texts, **paths))
    try:
        return LockstepPort(simulation) if speed == "max" else RealtimePort(simulation)
    except BoardGone as e:
        simulation.close()
        raise CannotOpen(f"the virtual board has ended at its start{e.why}") from None
    except BaseException:  # Ctrl-C
        simulation.close()
        raise


class RealtimePort(SocketPort):
    """A virtual board in a thread, in real time."""

    def __init__(self, simulation: Simulation) -> None:
        ours, theirs = socket.socketpair()
        super().__init__(ours, "the virtual board")
        self.simulation = simulation
        self._failed: Exception | None = None  # why the board has gone
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._live, args=(PairPort(theirs),), name="virtual board", daemon=True)
        self._thread.start()

    def _live(self, port: PairPort) -> None:
        try:
            serve(self.simulation, [port], self._stopping.is_set)
        except (BoardGone, MountError) as e:
            self._failed = e
        finally:
            port.close()  # its client finds it closed

    def read(self, timeout_s: float) -> bytes:
        """As SocketPort's; the error has the cause."""
        with self._caused():
            return super().read(timeout_s)

    def write(self, data: bytes) -> None:
        """As SocketPort's; the error has the cause."""
        with self._caused():
            super().write(data)

    @contextlib.contextmanager
    def _caused(self) -> Iterator[None]:
        try:
            yield
        except ConnectionLost as e:
            if not str(self._failed or ""):
                raise
            raise ConnectionLost(f"{e}: {self._failed}") from self._failed

    def close(self) -> None:
        """Power off."""
        self._stopping.set()
        super().close()
        self._thread.join(5)
        self.simulation.close()


class LockstepPort:
    """A virtual board whose time passes only in read() and sleep().

    run: lets so many microseconds pass, or fewer if a condition comes true; default: for this board alone.
    """

    lockstep = True

    def __init__(self, simulation: Simulation, board: Lockstep | None = None, run: Run | None = None) -> None:
        self.simulation = simulation
        self._lockstep = board or Lockstep(simulation)
        self._run = run or self._lockstep.run
        self._gone = False

    def monotonic(self) -> float:
        """Seconds of the board's time."""
        return self.simulation.now_us * 1e-6

    def sleep(self, seconds: float) -> None:
        """Let the board's time pass."""
        self._pass(seconds, lambda: False)

    def read(self, timeout_s: float) -> bytes:
        """Bytes that are there, or come within timeout_s of the board's time; may be none."""
        received = self._lockstep.received
        self._check_there()
        self._pass(timeout_s, lambda: bool(received))
        data = bytes(received)
        received.clear()
        return data

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._check_there()
        self._lockstep.send(data)

    def _check_there(self) -> None:
        """Raises ConnectionLost once interference has taken the port away."""
        self._gone = self._gone or self.simulation.disturbed
        if self._gone:
            raise ConnectionLost("the virtual board's port has gone")

    def close(self) -> None:
        """Power off."""
        self.simulation.close()

    def _pass(self, seconds: float, until: Callable[[], bool]) -> None:
        """A microsecond at least, or who waits for the rest of one would wait for ever."""
        try:
            self._run(max(round(seconds * 1e6), 1) if seconds > 0 else 0, until)
        except BoardGone as e:
            raise ConnectionLost(f"the virtual board is gone{e.why}") from e
