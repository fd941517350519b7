"""The hardware's verbs on MicroPython (RP2040 and RP2350). Only ports/micropython*.py and rp2_*.py name `machine`.

The protocol runs on the console, sys.stdin and sys.stdout, so Ctrl-C (0x03) belongs to the
interpreter and raises KeyboardInterrupt.
"""

import binascii
import gc
import hashlib
import os
import sys
import time

import machine
import micropython
from machine import PWM, Pin

from mountfw import codes, const
from mountfw.ports import micropython_encoder, shared
from mountfw.ports.micropython_console import pack, writable, write  # noqa: F401 (verbs of this port, too)

ticks_us = time.ticks_us  # pyright: ignore[reportAttributeAccessIssue]
ticks_ms = time.ticks_ms  # pyright: ignore[reportAttributeAccessIssue]
pause_us = time.sleep_us  # pyright: ignore[reportAttributeAccessIssue]

_CTRL_C = const(3)

_HUNG_MS = const(1000)  # the watchdog waits so long: more than a flash sector's erase at its worst (400 ms, W25Q16JV)
# The watchdog's registers: RP2040 data sheet 4.7.6, RP2350 data sheet 12.9.7. Another chip gets no watchdog.
_WATCHDOGS = {"RP2040": 0x40058000, "RP2350": 0x400D8000}
_machine = getattr(sys.implementation, "_machine", "")
_chip = "RP2350" if "RP2350" in _machine else _machine[-6:]  # its RISC-V cores: "... with RP2350-RISCV"
_watchdog_registers = _WATCHDOGS.get(_chip)
_CLEAR = const(0x3000)  # where a write clears bits
_ENABLE = 1 << 30
_SCRATCH4 = const(0x1C)
_TIMED_OUT = 0x6AB73121  # what the SDK leaves there: the watchdog was armed, not used for a wanted reset

# The PWM's counters: RP2040 data sheet 4.5.3, RP2350 data sheet 12.5.3: CH0_CTR, 20 bytes a slice, TOP 8 bytes behind
_PWMS = {"RP2040": 0x40050008, "RP2350": 0x400A8008}
_counters = _PWMS.get(_chip)

TUNABLE = True  # do outputs with a duty have set_hz() and shows?

_HERE = os.getcwd().rstrip("/") + "/"  # the loop's folder: at the prompt, where a drive removes a file, it may change

_led = None
_gate = None
rp2_gate = None
if getattr(sys, "platform", "") == "rp2" and _chip == "RP2040":
    from mountfw.ports import rp2_gate
    from mountfw.ports.rp2_gate import DutyPin  # pyright: ignore[reportAssignmentType]  # or that below
    from mountfw.ports.rp2_lane import EnableBridge, lane  # noqa: F401 (verbs, too)
else:
    from mountfw.ports.micropython_console import any, drain  # noqa: F401 (verbs, too)

    class DutyPin:
        """A pin that can carry a duty.

        low() and high() go through the pin's function, at once. The PWM behind the pin keeps its old
        duty to the end of its period, and shows it only while the pin's function is PWM. shows: 0 low,
        1 high, 2 a duty.
        """

        def __init__(self, number, pwm_hz):
            pin = Pin(number, Pin.OUT, value=0)
            self._function = pin.init
            pwm = PWM(pin, freq=pwm_hz, duty_u16=0)
            self._duty_u16 = pwm.duty_u16
            self.set_hz = pwm.freq  # of both outputs of its slice
            # made once: a number so large takes memory
            self._counter = _counters and _counters + 20 * (number >> 1 & 7 if number < 32 else 8 + (number >> 1 & 3))
            self._top = self._counter and self._counter + 8
            self.low()

        def low(self):
            """Pin low."""
            self._function(Pin.OUT, value=0)
            self.shows = 0

        def high(self):
            """Pin high."""
            self._function(Pin.OUT, value=1)
            self.shows = 1

        def level(self, duty_u16):
            """Pin at duty_u16, 0 ... 65535: at once, or where it has a duty already, from its next period on."""
            self._duty_u16(duty_u16)
            if self.shows != 2 and self._counter:
                machine.mem32[self._counter] = machine.mem32[self._top]  # a period begins
            self._function(Pin.ALT, alt=Pin.ALT_PWM)
            self.shows = 2


def output(number, pwm_hz=0):
    """An output pin, low from the start: low() and high(), and with pwm_hz level() too."""
    return DutyPin(number, pwm_hz) if pwm_hz or rp2_gate else Pin(number, Pin.OUT, value=0)


def gate(board):
    """The gate of a board's drive pins (docs/gate.md), not yet in place; None on a chip where it was not tried."""
    global _gate
    if not rp2_gate:
        return None
    from mountfw.board_file import gate_pins  # needed at the start only

    _gate = rp2_gate.Gate(gate_pins(board), getattr(board, "GATE", True))
    return _gate


def reader(number):
    """A function that reads input pin `number` (0 or 1) against its pull-up; None for None."""
    return None if number is None else Pin(number, Pin.IN, Pin.PULL_UP).value


def analog(number):
    """A function that reads analog input `number`, 0 ... 65535: some microseconds."""
    return machine.ADC(Pin(number)).read_u16


def encoder(number, pins):
    """The reader (encoders.py) of an axis whose pins name an encoder; None, after a printed line."""
    return micropython_encoder.reader(number, pins)


def on_rise(number, handler):
    """Call handler(pin) from a hard interrupt when input pin `number` rises. It must not allocate."""
    Pin(number, Pin.IN, Pin.PULL_UP).irq(handler, Pin.IRQ_RISING, hard=True)


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
    """Why the board started, as in codes.py."""
    if machine.reset_cause() != machine.WDT_RESET:
        return codes.POWER
    if _watchdog_registers and machine.mem32[_watchdog_registers + _SCRATCH4] == _TIMED_OUT:
        return codes.WATCHDOG
    return codes.ASKED


def start_watchdog():
    """From here on the board is reset unless the function that this returns is called every second."""
    if _watchdog_registers:
        return machine.WDT(timeout=_HUNG_MS).feed
    return stop_watchdog


def stop_watchdog():
    """No feeding is needed from here on: at the prompt, in a deploy. MicroPython has no verb for it.

    The mark goes as well: a soft reset keeps reset_cause() of the reset before it, which need not have been a hang.
    """
    if _watchdog_registers:
        machine.mem32[_watchdog_registers + _CLEAR] = _ENABLE
        machine.mem32[_watchdog_registers + _SCRATCH4] = 0


def collect():
    """Free what starting up has left behind; the loop leaves nothing."""
    gc.collect()


def free_memory():
    """Bytes of the heap that are free. Allocates nothing, but walks the heap: ask it seldom."""
    return gc.mem_free()  # pyright: ignore[reportAttributeAccessIssue]


def load(name):
    """The first bytes of a file, b"" if it cannot be read, None if it is absent."""
    return shared.read_file(_HERE + name)


def store(name, data):
    """Make a file of these bytes. Raises OSError."""
    with open(name, "wb") as f:
        f.write(data)


rename = os.rename  # littlefs does it whole or not at all, even onto a file that is there


def remove(name):
    """Remove a file. Raises OSError."""
    os.remove(_HERE + name)


def firmware_hash():
    """Yield None after each part of the work, and last `sha256-` and the hash in hex (bytes) of the firmware's files.

    These are main.py and every .py and .mpy of mountfw on this board. For each, in the order of their names from the
    root on: the name, then the SHA-256 of the file (32 bytes). Raises OSError.
    """
    total = hashlib.sha256()
    buffer = bytearray(512)
    view = memoryview(buffer)
    for name, path in shared.firmware_files(os.listdir, __file__, ("main.py",)):
        digest = hashlib.sha256()
        with open(path, "rb") as f:
            n = f.readinto(buffer)
            while n:
                digest.update(view[:n])
                yield None
                n = f.readinto(buffer)
        total.update(name.encode())
        total.update(digest.digest())
    yield b"sha256-" + binascii.hexlify(total.digest())


def find_board():
    """The board file, as board_file.find_board() says, by the name of this board; its LED is set up."""
    from mountfw import board_file  # needed at the start only

    if rp2_gate:
        from mountfw.ports import rp2_handlers  # noqa: F401 (gate() needs it, and now it takes a third)
    global _led
    title = (_machine or "unknown board").split(" with ")[0]
    name = "".join([c.lower() if c.isalpha() or c.isdigit() else "_" for c in title])
    board = board_file.find_board(title, name, os.listdir, True)
    number = board_file.led_of(board, title.endswith(" W")) if board else None
    if number is not None:
        try:
            _led = Pin(number, Pin.OUT, value=0)
        except ValueError:
            pass  # this board has none of that name
    return board


def motors_off(board):
    """Every drive pin low: the enables first, then the legs."""
    for number in shared.drive_pins(board):
        Pin(number, Pin.OUT, value=0)


def uninterrupted(action, argument):
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
    """Motors off and watchdog off on the way to the prompt, however often Ctrl-C comes meanwhile."""
    uninterrupted(_leave, board)


def _leave(board):
    motors_off(board)
    if _gate:
        _gate.leave()
    stop_watchdog()
