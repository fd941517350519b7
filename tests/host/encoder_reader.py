"""A board that does nothing but drive two motors and count their encoders, on each machine that has fakes.

One letter a command: f r F R drive motor 1 or 2 either way, o O switch it off, c prints both counts.
"""

from pathlib import Path

from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.clocks import Lockstep

_LOOP = """
one = bytearray(1)
while True:
    read(one)
    c = chr(one[0])
    pins = (2, 3, 4) if c in "fro" else (5, 6, 7)
    if c in "fFrR":
        drive[pins[1 if c in "fF" else 2]](True)
        drive[pins[0]](True)
    elif c in "oO":
        for pin in pins:
            drive[pin](False)
    elif c == "c":
        write(("%d %d\\n" % counts()).encode())
"""
_MICROPYTHON = """
import sys
from array import array
import micropython
import rp2
from machine import I2C, Pin
micropython.kbd_intr(-1)
drive = {n: Pin(n, Pin.OUT, value=0).value for n in (2, 3, 4, 5, 6, 7)}
read, write = sys.stdin.buffer.readinto, sys.stdout.buffer.write
Pin(25, Pin.OUT, value=1)
"""
_COUNTS = """
@rp2.asm_pio(fifo_join=rp2.PIO.JOIN_RX)
def quadrature():
    pass
machines = [rp2.StateMachine(i, quadrature, in_base=Pin(a, Pin.IN, Pin.PULL_UP)) for i, a in enumerate((8, 26))]
for machine in machines:
    machine.active(1)
words = array("i", [0] * 6)
def counts():
    return tuple([machine.get(words)[5] >> 2 for machine in machines])
"""
_ANGLES = """
buses = [I2C(i, scl=Pin(sda + 1), sda=Pin(sda)) for i, sda in enumerate((8, 26))]
data = bytearray(3)
def counts():
    angles = []
    for bus in buses:
        try:
            bus.readfrom_mem_into(0x36, 0x0B, data)
            angles.append(data[1] << 8 | data[2])
        except OSError:
            angles.append(-1)
    return tuple(angles)
"""
_CIRCUITPYTHON = """
import busio, digitalio, microcontroller, rotaryio, select, usb_cdc
def output(number):
    pin = digitalio.DigitalInOut(getattr(microcontroller.pin, "GPIO%d" % number))
    pin.switch_to_output(False)
    return lambda level: setattr(pin, "value", level)
drive = {n: output(n) for n in (2, 3, 4, 5, 6, 7)}
port = usb_cdc.data or usb_cdc.console
port.timeout = port.write_timeout = 0
write = port.write
waits = select.poll()
waits.register(port, select.POLLIN)
def read(buffer):
    while not port.readinto(buffer):
        waits.ipoll(1000)
output(25)(True)
gpio = microcontroller.pin
"""
_POSITIONS = """
pairs = ((gpio.GPIO8, gpio.GPIO9), (gpio.GPIO26, gpio.GPIO27))
encoders = [rotaryio.IncrementalEncoder(a, b, 1) for a, b in pairs]
def counts():
    return tuple([encoder.position for encoder in encoders])
"""
_BUSES = """
buses = [busio.I2C(gpio.GPIO9, gpio.GPIO8), busio.I2C(gpio.GPIO27, gpio.GPIO26)]
data = bytearray(3)
def counts():
    angles = []
    for bus in buses:
        bus.try_lock()
        bus.writeto_then_readfrom(0x36, b"\\x0b", data)
        bus.unlock()
        angles.append(data[1] << 8 | data[2])
    return tuple(angles)
"""
PROGRAMS = {
    ("micropython", "motor"): _MICROPYTHON + _COUNTS + _LOOP,
    ("micropython", "shaft"): _MICROPYTHON + _ANGLES + _LOOP,
    ("circuitpython", "motor"): _CIRCUITPYTHON + _POSITIONS + _LOOP,
    ("circuitpython", "shaft"): _CIRCUITPYTHON + _BUSES + _LOOP,
}


class Reader:
    """The board, in lockstep. tmp_path gets its program."""

    def __init__(self, tmp_path: Path, machine: str, encoder: str, **options) -> None:
        text = PROGRAMS["circuitpython" if machine == "circuitpython" else "micropython", encoder]
        if machine == "cpython":
            place = tmp_path / "mountfw" / "entry" / "main.py"
            where = {"firmware": tmp_path, "files": tmp_path}
        else:
            place = tmp_path / ("code.py" if machine == "circuitpython" else "main.py")
            where = {"files": tmp_path}
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)
        self.simulation = make_simulation(Options(machine=machine, encoder=encoder, **where, **options))
        self.bench = self.simulation.bench
        self.board = Lockstep(self.simulation)
        self.board.boot()
        self._first = self.counts(), self.true()

    def run(self, letters: bytes, us: int) -> None:
        """Send commands, and let so much time pass."""
        self.board.send(letters)
        self.board.run(us)

    def counts(self) -> list[int]:
        """What the board has counted."""
        self.board.received.clear()
        self.board.send(b"c")
        assert self.board.run(1_000_000, lambda: b"\n" in self.board.received)
        return [int(word) for word in bytes(self.board.received).split()]

    def true(self) -> list[int]:
        """The counts of the bench's discs."""
        return [encoder.count(self.bench.trains[motor]) for motor, encoder in self.bench.encoders.items()]

    def counted(self) -> list[int]:
        """What the board has counted since the beginning."""
        return [now - first for now, first in zip(self.counts(), self._first[0], strict=True)]

    def turned(self) -> list[int]:
        """What it should have counted since the beginning."""
        return [now - first for now, first in zip(self.true(), self._first[1], strict=True)]

    def close(self) -> None:
        """Power off."""
        self.simulation.close()
