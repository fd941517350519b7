"""The hardware's verbs on MicroPython (RP2040 and RP2350). The only file that names `machine`.

The protocol runs on the console, sys.stdin and sys.stdout, so Ctrl-C (0x03) belongs to the
interpreter and raises KeyboardInterrupt.
"""

import binascii
import gc
import hashlib
import os
import select
import sys
import time

import machine
import micropython
from machine import PWM, Pin

ticks_us = time.ticks_us  # pyright: ignore[reportAttributeAccessIssue]
ticks_ms = time.ticks_ms  # pyright: ignore[reportAttributeAccessIssue]
pause_us = time.sleep_us  # pyright: ignore[reportAttributeAccessIssue]

_CTRL_C = 3


def _ipoll(stream, events):
    """The ipoll() of a poll object for events of stream. It allocates nothing, once it has given an answer:
    so it gives one here, about output, which is ready when nothing has been sent yet."""
    poll = select.poll()
    poll.register(stream, select.POLLOUT)
    ipoll = poll.ipoll  # pyright: ignore[reportAttributeAccessIssue]
    for _ in ipoll(0):
        pass
    poll.modify(stream, events)
    return ipoll


_ipoll_in = _ipoll(sys.stdin, select.POLLIN)
_ipoll_out = _ipoll(sys.stdout, select.POLLOUT)
_readinto = sys.stdin.buffer.readinto  # pyright: ignore[reportAttributeAccessIssue]
_write = sys.stdout.buffer.write
_byte_in = bytearray(1)
_byte_out = bytearray(1)
_led = None


def any(wait_ms):
    """True as soon as a byte waits; False after wait_ms without one."""
    for _ in _ipoll_in(wait_ms):
        return True
    return False


def read():
    """The byte that waits."""
    _readinto(_byte_in)
    return _byte_in[0]


def writable():
    """True if write() will not block."""
    for _ in _ipoll_out(0):
        return True
    return False


def write(c):
    """Send byte c."""
    _byte_out[0] = c
    _write(_byte_out)


class Output:
    """An output pin, low from the start; with pwm_hz it can carry a duty.

    low() and high() go through the pin's function, at once. The PWM behind the pin keeps its old
    duty to the end of its period, and shows it only while the pin's function is PWM.
    """

    def __init__(self, number, pwm_hz=0):
        self._pin = Pin(number, Pin.OUT, value=0)
        if pwm_hz:
            self._pwm = PWM(self._pin, freq=pwm_hz, duty_u16=0)
            self.low()

    def low(self):
        """Pin low."""
        self._pin.init(Pin.OUT, value=0)

    def high(self):
        """Pin high."""
        self._pin.init(Pin.OUT, value=1)

    def level(self, duty_u16):
        """Pin at duty_u16, 0 ... 65535."""
        self._pwm.duty_u16(duty_u16)
        self._pin.init(Pin.ALT, alt=Pin.ALT_PWM)


def reader(number):
    """A function that reads input pin `number` (0 or 1) against its pull-up; None for None."""
    return None if number is None else Pin(number, Pin.IN, Pin.PULL_UP).value


def led(on):
    """The board's LED."""
    if _led is not None:
        _led.value(on)


def unique_id():
    """The chip's own number, as hex (bytes)."""
    return "".join(["%02x" % b for b in machine.unique_id()]).encode()


def boot_id():
    """A number that differs from boot to boot, 0 ... 2**30-1."""
    return int.from_bytes(os.urandom(4), "little") & 0x3FFFFFFF


def reset_cause():
    """Why the board started, in MicroPython's own numbers of this platform (machine.reset_cause)."""
    return machine.reset_cause()


def free_memory():
    """Bytes of the heap that are free. Allocates nothing, but walks the heap: ask it seldom."""
    return gc.mem_free()  # pyright: ignore[reportAttributeAccessIssue]


def firmware_hash():
    """SHA-256, as hex (bytes), over the files that are on this board: main.py and every .py and .mpy of mountfw.

    For each, in the order of their names from the root on: the name, then the SHA-256 of the file (32 bytes).
    """
    library = __file__.rpartition("/")[0]
    root = library.rpartition("/")[0]
    total = hashlib.sha256()
    for folder in ("", "mountfw", "mountfw/boards"):
        place = (root + "/" if root else "") + folder
        for name in sorted(os.listdir(place)):
            if name == "main.py" if not folder else name.endswith((".py", ".mpy")):
                total.update((folder + "/" + name if folder else name).encode())
                total.update(_file_hash(place + "/" + name if place else name))
    return binascii.hexlify(total.digest())


def _file_hash(path):
    digest = hashlib.sha256()
    buffer = bytearray(512)
    view = memoryview(buffer)
    with open(path, "rb") as f:
        while True:
            n = f.readinto(buffer)
            if not n:
                return digest.digest()
            digest.update(view[:n])


def find_board():
    """The board file: boards/this.py if there is one, else that of this board by its name.

    None, after a line that names the file to write, if there is none.
    """
    global _led
    machine_name = getattr(sys.implementation, "_machine", "unknown board").split(" with ")[0]
    name = "".join([c.lower() if c.isalpha() or c.isdigit() else "_" for c in machine_name])
    if name in ("raspberry_pi_pico", "raspberry_pi_pico_w"):
        name = "pico"
    for candidate in ("this", name):
        try:
            board = getattr(__import__("mountfw.boards." + candidate).boards, candidate)
        except ImportError:
            continue
        _led = Pin(board.LED, Pin.OUT, value=0)
        return board
    print("mountfw: no board file for '%s': write mountfw/boards/%s.py (copy pico.py)" % (machine_name, name))
    return None


def motors_off(board):
    """Every drive pin low: the enables first, then the legs."""
    for name in ("en", "pos", "neg"):
        for pins in (board.AXIS_1, board.AXIS_2):
            if pins[name] is not None:
                Pin(pins[name], Pin.OUT, value=0)


def undisturbed(action, argument):
    """action(argument), from the start again however often Ctrl-C comes meanwhile."""
    while True:
        try:
            micropython.kbd_intr(-1)
            try:
                action(argument)
            finally:
                micropython.kbd_intr(_CTRL_C)
            return
        except KeyboardInterrupt:
            pass


def leave(board):
    """Motors off on the way to the prompt, however often Ctrl-C comes meanwhile."""
    undisturbed(motors_off, board)
