"""The simulation around the virtual board: it starts the firmware's process and owns the clock.

The firmware runs in a child process (its command line: machines.py) and blocks at the end of each granted interval.
Simulation reads its records (next_wait), passes the pin edges to the bench, and grants the next interval (go).
clocks.py chooses the length of the interval: as far as the caller waits, or by the wall clock.
"""

import contextlib
import json
import math
import os
import random
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from tempfile import TemporaryDirectory
from typing import IO

from mirrormount.device.calibration import Scale, Step, beam_per_mirror
from mirrormount.errors import CannotOpen, CannotWrite
from mirrormount_sim.bench import BUS, ENCODERS, INCIDENCE, LED, SWITCHES, Bench
from mirrormount_sim.profiles import EMI_GONE, EMI_GONE_S, EMI_LOST, EMI_S
from mirrormount_sim.truth import Truth

_KEPT = 4096  # bytes: a firmware may make an emulator complain for a week
FULL_DUTY = 255  # of a board's setting step_duty
_PATIENCE_S = 1.0  # until the rest has come of a process that has ended


# ---- what the firmware has written last


class StderrTail:
    """Reads the stream, so that its writer never waits."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._tail = stream, b""
        self._thread = threading.Thread(target=self._read, name="stderr tail", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with self._stream as stream:
            while data := os.read(stream.fileno(), _KEPT):
                self._tail = (self._tail + data)[-_KEPT:]

    def line(self) -> str:
        """The last line that is not empty, "" if there is none."""
        self._thread.join(_PATIENCE_S)
        lines = self._tail.decode(errors="replace").split("\n")
        return next((line.strip()[:200] for line in reversed(lines) if line.strip()), "")


# records of the seam; virtual/fakes/_seam.py explains them
_CHANGE, _ENDS = b"QN"


# ---- interference


class Interference:
    """The brushes of motors that start disturb the board's USB cable: bytes to the board are lost, or the port goes."""

    def __init__(self, seed: int) -> None:
        self._noise = random.Random(seed)
        self._until_us = self._back_us = 0

    def start(self, us: int) -> None:
        """A motor starts."""
        self._until_us = us + round(EMI_S * 1e6)
        if self._noise.random() < EMI_GONE:
            self._back_us = us + round(EMI_GONE_S * 1e6)

    def gone(self, us: int) -> bool:
        """True while the port is not there."""
        return us < self._back_us

    def left(self, us: int, received: bytes | bytearray) -> bytes:
        """What comes of bytes that the host has sent."""
        if self.gone(us):
            return b""
        lost = EMI_LOST if us < self._until_us else 0.0
        return bytes(c for c in received if not lost or self._noise.random() >= lost)


# ---- the wires of encoders


class EncoderWires:
    """What one board, since it was switched on, has been told."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._wires = {
            motor: (ENCODERS[motor] if encoder.kind == "motor" else (BUS + ENCODERS[motor][0],))
            for motor, encoder in bench.encoders.items()
            if motor in ENCODERS
        }
        self._known: dict[int, int] = {}  # wire to level, before those of _told
        self._told: list[tuple[int, int, int]] = []  # (us, wire, level)
        self._new = True

    def tell(self, now_us: int, until_us: int) -> Iterator[tuple[int, int, int, int]]:
        """Records (kind, wire, level, us) for a board that has come to now_us and may go on to until_us."""
        if self._new:
            self._new = False
            for pin in self._bench.wires:
                yield _ENDS, pin, 1, 0
        self._bench.look_ahead(until_us)
        self._known.update((wire, level) for us, wire, level in self._told if us <= now_us)
        told = []
        for motor, wires in self._wires.items():
            encoder = self._bench.encoders[motor]
            shown = {wire: self._known.get(wire) for wire in wires}
            changes = [(now_us, encoder.at(now_us))]
            changes += [(change.us, change.wires) for change in encoder.between(now_us, until_us)]
            for us, levels in changes:
                for wire, level in zip(wires, levels, strict=True):
                    if level != shown[wire]:
                        shown[wire] = level
                        told.append((us, wire, level))
            encoder.forget(now_us)
        self._told = sorted(told, key=lambda change: change[0])
        for us, wire, level in self._told:
            yield _CHANGE, wire, level, us


# the seam's records; virtual/fakes/_seam.py is the other side and explains them
_RECORD = struct.Struct("<BBHIQ")
_EDGE, _SENT, _WAIT, _USB, _FLASH, _LANDED = b"ETSUFL"
_RECEIVED, _PIN, _COLLECTS, _GO, _OPEN, _RESET, _CUT, _REMEMBER, _EJECT = b"RPWGDXCMJ"

# half a second before the firmware's 30-bit clock wraps: every board lives through a wrap early
START_US = (1 << 30) - 500_000
EDGES_KEPT = 5_000  # at least
CLOSING_US = 1_000_000  # of the truth, after the power went

# Ctrl-C in a terminal is the host's, also while its child has only begun to start
_APART: dict = {"process_group": 0} if os.name == "posix" else {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}


# ---- the simulation


class BoardGone(Exception):
    """The firmware's process has ended. Its text is the process's last line on stderr, if that was kept."""

    @property
    def why(self) -> str:
        """ ": " and that line, or nothing: for the end of a sentence."""
        return f": {self}" if str(self) else ""


class Simulation:
    """A virtual board and its bench.

    machine: the command line of the child that is the board (see machines.py). edges: a text file
    that gets one JSON object per pin edge. truth: gets the ends of motions. scratch: folders that go when the board
    does. start_us: its clock at power-up, as in machine. quiet: nothing that the child writes on stderr is shown, but
    for its last line in BoardGone.
    on_sent is called with each byte that the board sends, on_console with those of a console beside its port.
    probes, {GPIO number: name}, may be filled with other pins whose edges are to be kept; nothing is connected to
    those.
    usb says whether the board's port is there: a machine that resets itself takes it away meanwhile, and so may
    interference.
    """

    def __init__(
        self,
        machine: Sequence[str],
        bench: Bench | None = None,
        *,
        edges: IO[str] | None = None,
        truth: Truth | None = None,
        scratch: Iterable[TemporaryDirectory] = (),
        start_us: int = START_US,
        quiet: bool = False,
        interference: Interference | None = None,
    ) -> None:
        self.bench = bench or Bench()
        self.bench.advance(start_us)
        self.edges: list[tuple[int, str, int]] = []  # the last ones: (us since power-up, pin, duty)
        self.probes: dict[int, str] = {}
        self.on_sent: Callable[[int], None] = lambda _c: None
        self.on_console: Callable[[int], None] = lambda _c: None
        self._edges_file = edges
        self._truth = truth
        self._interference = interference
        if truth:
            truth.watch(self.bench)
        self._scratch = scratch
        self.analog: dict[int, Callable[[], int]] = {}  # of a GPIO: its voltage now, as ADC.read_u16() tells it
        self._sent_levels: dict[str, int] = {}
        self._encoder_wires = EncoderWires(self.bench) if self.bench.encoders else None
        self._collects = True
        self._opened = True
        self._plugged = True
        self.flash_operations = 0  # erases and programs so far, of a machine that has a flash
        self.landed = 0, 0  # the last packet's, in an emulated board: (us since power-up, bytes that still waited)
        self._wants_us: int | None = None  # while the firmware waits to go on
        self.lit = False  # the board's LED
        self.at_prompt = False  # of Python, on the port: input is executed as Python
        self._tail = bytearray()  # what the board sent last
        try:
            pipe = subprocess.PIPE
            self._child = subprocess.Popen(machine, stdin=pipe, stdout=pipe, stderr=pipe if quiet else None, **_APART)
        except OSError as e:
            raise CannotOpen(f"the virtual board cannot be started: {machine[0]}: {e.strerror}") from e
        assert self._child.stdin and self._child.stdout
        self._to_child, self._from_child = self._child.stdin, self._child.stdout
        self._stderr_tail = StderrTail(self._child.stderr) if self._child.stderr else None
        self._child.stderr = None  # close() leaves it to the reader
        self.now_us = start_us
        # for another thread, in one piece: a time of the board, the same on the wall, and until when no pin changes
        self._paced = start_us, time.monotonic(), start_us
        self._looking = threading.Lock()  # the bench is read by another thread
        self.waiting_in = 0  # bytes that the board has received and not read

    @property
    def us(self) -> int:
        """Microseconds since the power-up of a board that started with its bench."""
        return self.now_us - START_US

    @property
    def usb(self) -> bool:
        """True while the board's port is there."""
        return self._plugged and not self.disturbed

    @property
    def disturbed(self) -> bool:
        """True while interference has taken the port away."""
        return self._interference is not None and self._interference.gone(self.now_us)

    @property
    def wall_us(self) -> int:
        """now_us of a board in real time, for another thread: now_us itself stands still while the firmware waits.

        A board whose process the computer keeps from running stands still, too: only the firmware can tell what its
        pins would have done, so a motor that is on does not run on by the wall's clock.
        """
        now_us, at_s, until_us = self._paced
        return min(now_us + round((time.monotonic() - at_s) * 1e6), until_us)

    def mirrors_now_rad(self) -> list[tuple[float, float]]:
        """As Bench.mirrors_rad(), of a board in real time, for another thread."""
        with self._looking:
            return self.bench.mirrors_rad(self.wall_us)

    def scale(self, axis: int, step: Step) -> Scale | None:
        """The scale of an axis by its number; None but for steps at full duty that turn a motor."""
        motor = f"m{axis}"
        if step.step_duty != FULL_DUTY or motor not in self.bench.trains:
            return None
        ways = self.bench.step_mrad(motor, step.pulse_us)
        if not all(ways):
            return None
        positive, negative = reversed(ways) if step.inverted else ways
        return Scale(positive, negative, step, beam_per_mirror("y" if axis % 2 else "x", math.degrees(INCIDENCE)))

    def next_wait(self) -> int:
        """Read records until the firmware blocks at now_us. Returns the us after which it continues by itself.

        Raises BoardGone when its process has ended.
        """
        while self._wants_us is None:
            record = self._from_child.read(_RECORD.size)
            if len(record) < _RECORD.size:
                raise self._gone()
            kind, a, b, dt, t = _RECORD.unpack(record)
            if kind == _WAIT:
                self.now_us = t
                self.waiting_in = b
                with self._looking:
                    self.bench.advance(t)
                    self._paced = t, time.monotonic(), t + dt
                self._wants_us = dt
            elif kind == _SENT:
                if not b:
                    self._watch_prompt(a)
                (self.on_console if b else self.on_sent)(a)
            elif kind == _USB:
                self._plugged = bool(a)
                self.at_prompt = self.at_prompt and self._plugged
            elif kind == _FLASH:
                self.flash_operations += 1
            elif kind == _LANDED:
                self.landed = t - START_US, b
            elif kind == _EDGE and a in self.bench.wires:
                self._edge(t, self.bench.wires[a], b, dt)
            elif kind == _EDGE and a == LED:
                self.lit = b > 0
            elif kind == _EDGE and a in self.probes:
                self._note(t, self.probes[a], b)
        return self._wants_us

    def _gone(self) -> BoardGone:
        return BoardGone(self._stderr_tail.line() if self._stderr_tail else "")

    def _watch_prompt(self, c: int) -> None:
        """Set at_prompt from the output: no answer of the firmware resembles a prompt or a soft reset."""
        tail = self._tail
        tail.append(c)
        if c in b" >" and tail.endswith((b">>> ", b"exit\r\n>")):
            self.at_prompt = True
        elif c == 0x74 and tail.endswith(b"soft reboot"):
            self.at_prompt = False
        if len(tail) > 256:
            del tail[:-16]

    def go(self, t_us: int, grant_us: int, received: bytes | bytearray = b"") -> None:
        """Let the firmware go on at t_us (>= now_us) for at most grant_us, with bytes received."""
        out = bytearray()
        told_us = self.now_us  # the board knows what was before
        with self._looking:
            self.bench.advance(t_us)
            self._paced = t_us, time.monotonic(), t_us  # what its pins do next is told behind
        for number, name in SWITCHES.items():
            level = self.bench.switch_levels().get(name, 1)  # not connected: pulled up
            if level != self._sent_levels.get(name, 1):
                self._sent_levels[name] = level
                out += _RECORD.pack(_PIN, number, level, 0, 0)
            elif name not in self._sent_levels:
                self._sent_levels[name] = level
        for number, read in self.analog.items():
            out += _RECORD.pack(_PIN, number, read(), 0, 0)
        if self._interference:
            received = self._interference.left(t_us, received)
        if self._truth and received:
            self._truth.hear(received)
        for c in received:
            out += _RECORD.pack(_RECEIVED, c, 0, 0, 0)
        self.now_us = t_us
        self._wants_us = None
        switch_us = self.bench.next_switch_us(grant_us) if grant_us else None
        if switch_us is not None:
            grant_us = min(grant_us, switch_us - t_us)
        if self._encoder_wires:
            for kind, wire, level, us in self._encoder_wires.tell(told_us, t_us + grant_us):
                out += _RECORD.pack(kind, wire, level, 0, us)
        out += _RECORD.pack(_GO, 0, 0, grant_us, t_us)
        try:
            self._to_child.write(out)
            self._to_child.flush()
        except (OSError, ValueError) as e:  # ValueError: closed by ourselves
            raise self._gone() from e

    def next_event_us(self, horizon_us: int) -> int:
        """Microseconds from now, at most horizon_us, in which nothing outside the firmware happens."""
        at = self.bench.next_switch_us(horizon_us)
        return horizon_us if at is None else at - self.now_us

    def collects(self, ready: bool) -> None:
        """Whether the host takes what the board sends. Told to the firmware with the next go()."""
        if ready != self._collects:
            self._collects = ready
            self._to_child.write(_RECORD.pack(_COLLECTS, int(ready), 0, 0, 0))

    def opened(self, by_someone: bool) -> None:
        """Whether a program has the port open (DTR). Told to a machine that has USB, with the next go()."""
        if by_someone != self._opened:
            self._opened = by_someone
            self._to_child.write(_RECORD.pack(_OPEN, int(by_someone), 0, 0, 0))

    def type(self, data: bytes) -> None:
        """Send bytes to the console of a board that has one beside its port; they go with the next go()."""
        self._to_child.write(b"".join(_RECORD.pack(_RECEIVED, c, 1, 0, 0) for c in data))

    def reset(self, *, power: bool) -> None:
        """Cut the power for a moment, or pulse the reset pin; happens with the next go()."""
        self._to_child.write(_RECORD.pack(_RESET, 0 if power else 1, 0, 0, 0))

    def eject(self) -> None:
        """Eject the drive that a CircuitPython board shows, so that it can write there; happens with the next go()."""
        self._to_child.write(_RECORD.pack(_EJECT, 0, 0, 0, 0))

    def remember_flash(self) -> None:
        """Save the contents of the flash for start_over(). Before the first call those at the start are saved."""
        self._to_child.write(_RECORD.pack(_REMEMBER, 0, 0, 0, 0))

    def start_over(self) -> None:
        """Cut the power for a moment, and restore the saved contents of the flash; happens with the next go()."""
        self._to_child.write(_RECORD.pack(_RESET, 2, 0, 0, 0))

    def cut_power(self, operations: int, *, half: bool) -> None:
        """Cut the power for a moment with so many more operations on the flash; half: the last one is left half done.

        Counts from the next go(), on a machine that has a flash.
        """
        self._to_child.write(_RECORD.pack(_CUT, int(half), 0, operations, 0))

    def close(self) -> None:
        """Power off: every drive ends."""
        self._child.kill()
        self._child.communicate()
        try:
            for pin, duty in list(self.bench.duties().items()):
                if duty:
                    self._edge(self.now_us, pin, 0)
        finally:
            if self._edges_file:
                with contextlib.suppress(OSError):  # a failed write was reported when it happened
                    self._edges_file.close()
                self._edges_file = None
            if self._truth:
                self.bench.advance(self.bench.us + CLOSING_US)  # what turns still comes to rest
                self.bench.on_rest = self.bench.on_drive = None
                self._truth.close()
            for folder in self._scratch:
                folder.cleanup()

    def _note(self, t: int, pin: str, duty: int) -> None:
        """Keep an edge: the last ones, for a board may run for a week."""
        self.edges.append((t - START_US, pin, duty))
        if len(self.edges) >= 2 * EDGES_KEPT:
            del self.edges[:EDGES_KEPT]

    def _edge(self, t: int, pin: str, duty: int, hz: int = 0) -> None:
        if round(self.bench.duties()[pin] * 65535) == duty:  # a reset drops every pin, whether it was up or not
            return
        stood = not self.bench.drive(pin[:2])
        with self._looking:
            self.bench.edge(t, pin, duty, hz)
        if self._interference and stood and self.bench.drive(pin[:2]):
            self._interference.start(t)
        self._note(t, pin, duty)
        if self._edges_file:
            carries_duty = pin.endswith("_en") or self.bench.two_pwm
            what = {"duty": duty} if carries_duty else {"level": duty // 65535}
            try:
                self._edges_file.write(json.dumps({"t_us": t - START_US, "pin": pin} | what) + "\n")
                self._edges_file.flush()
            except OSError as e:
                file, self._edges_file = self._edges_file, None
                raise CannotWrite(f"cannot write pin edges to {file.name}: {e.strerror}") from e
