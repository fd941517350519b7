"""The hardware's verbs on CircuitPython. Only ports/circuitpython*.py name its modules.

CircuitPython has no interrupts for Python code, so end-stops are polled. The finest clock that does not allocate has
steps of 1/1024 s. docs/circuitpython.md lists the consequences.

The protocol's stream of bytes is usb_cdc.data where boot.py has enabled that: the console stays the REPL's, and 0x03
is a stop. Where there are too few USB endpoints for two channels it is usb_cdc.console, and 0x03 interrupts the
program. A host that disconnects (its program ends, its port closes, the cable is pulled) stops all motion: after all
bytes that the host has sent, the loop receives one more `!`.

boot.py imports this, too, before USB starts.
"""

import binascii
import gc
import os
import select
import sys
import time

import board as pins
import digitalio
import microcontroller
import pwmio
import supervisor
import usb_cdc

from mountfw import board_file, codes
from mountfw.ports import circuitpython_encoder, shared
from mountfw.ports.circuitpython_storage import firmware_hash, load, remove, rename, store  # noqa: F401 (verbs, too)
from mountfw.wire import ticks
from mountfw.wire.frame import pack  # noqa: F401 (a verb of this port, too: there is no native code to be faster)

# ---- time

_WRAP_MASK = 0x3FFF_FFFF  # a literal: computed from 1 << 30 it would be a large integer, and allocate at each use
_MS_MASK = (1 << 29) - 1  # supervisor.ticks_ms() wraps there
_MOST_MS = (1 << 20) - 1  # between two readings; in microseconds still a small integer
_HALF = 1 << 29
_ticks_ms = supervisor.ticks_ms
_delay_us = microcontroller.delay_us

# The watchdog's timeout. When the PC writes to the drive, CircuitPython erases flash during a pass of the loop, up to
# 0.4 s a sector (W25Q16JV). A reset in an erase would damage the drive's file system.
_HUNG_S = 4


class _Clock:
    """Time that wraps at 2**30, in the steps of CircuitPython's clock, without an allocation.

    A step is 1/1024 s, and the clock is read as whole milliseconds, rounded down. So 128 steps are 125 ms, and three of
    them do not change the reading. The time of each change is known all the same: us() returns that of the last one.
    Call us() at least every 17 minutes: after a longer pause it loses time.
    """

    def __init__(self):
        while True:
            self._seen_ms = _ticks_ms()
            steps = (2 * time.monotonic_ns() + 1) // 1953125
            if _ticks_ms() == self._seen_ms:
                break
        # The millisecond's place among 125. It goes through text: a number that is computed from a large integer stays
        # one, and allocates at each use.
        self._place = int(str(steps * 1000 // 1024 % 125))
        self._ms = 0
        self._us = _WRAP_MASK - 499_999  # half a second before it wraps: each start tests that

    def us(self):
        """Microseconds."""
        now_ms = _ticks_ms()
        if now_ms != self._seen_ms:
            passed_ms = now_ms - self._seen_ms & _MS_MASK
            self._seen_ms = now_ms
            self._ms = self._ms + (passed_ms - _HALF - _HALF) & _WRAP_MASK
            self._forward(passed_ms & _MOST_MS)
        return self._us

    def _forward(self, passed_ms):
        place = self._place + passed_ms
        passed_us = place // 125 * 125_000 - _steps_us(self._place)
        self._place = place % 125
        passed_us += _steps_us(self._place)
        self._us = self._us + (passed_us - _HALF - _HALF) & _WRAP_MASK

    def ms(self):
        """Milliseconds."""
        self.us()
        return self._ms


def _steps_us(ms):
    """Microseconds of the step at which the clock first reads ms (0 ... 124)."""
    return (ms * 128 + 124) // 125 * 15625 // 16


_clock = _Clock()
ticks_us = _clock.us
ticks_ms = _clock.ms


def pause_us(us):
    """Wait for us and a PWM period, then for the clock's next step: a drive that begins on a step can end on one."""
    _delay_us(us + PERIOD_US)
    ms = _ticks_ms()
    while _ticks_ms() == ms:
        pass


# ---- pins

# A new duty takes effect at the end of the PWM's period (RP2040 data sheet 4.5.2). Off is a duty here: to drive the pin
# as a level, CircuitPython needs a new object. So no period is longer than 50 us, whatever the board file says.
_LEAST_PWM_HZ = 20_000
PERIOD_US = 50

_gpios = getattr(microcontroller, "pin")  # noqa: B009 (CircuitPython's stubs do not know it)
_outputs = {}  # {pin: its output}; CircuitPython reserves a pin until deinit() of its object
_inputs = {}
_led = None


def _pin_of(number):
    """GPIO `number`, or the pin of that name in the module `board`."""
    return getattr(pins, number) if isinstance(number, str) else getattr(_gpios, "GPIO%d" % number)


class _Level:
    """An output that is high or low."""

    def __init__(self, number):
        self.io = digitalio.DigitalInOut(_pin_of(number))
        self.io.switch_to_output(False)

    def low(self):
        """Pin low, at once."""
        self.io.value = False

    def high(self):
        """Pin high, at once."""
        self.io.value = True


class _Duty:
    """An output with a duty, which takes effect at the end of the PWM's period."""

    def __init__(self, number, pwm_hz):
        self.io = pwmio.PWMOut(_pin_of(number), duty_cycle=0, frequency=max(pwm_hz, _LEAST_PWM_HZ))

    def low(self):
        """Pin low."""
        self.io.duty_cycle = 0

    def high(self):
        """Pin high."""
        self.io.duty_cycle = 65535

    def level(self, duty_u16):
        """Pin at duty_u16, 0 ... 65535."""
        self.io.duty_cycle = duty_u16


def output(number, pwm_hz=0):
    """An output pin, low at first. Has low() and high(), and with pwm_hz also level()."""
    known = _outputs.get(number)
    if known and isinstance(known, _Duty) == (pwm_hz > 0):
        known.low()
        return known
    if known:
        known.low()
        known.io.deinit()
        del _outputs[number]
    _outputs[number] = _Duty(number, pwm_hz) if pwm_hz else _Level(number)
    return _outputs[number]


class TwoPwmBridge:
    """A bridge with two PWM inputs, as bridges.TwoPwmBridge: by Adafruit's DCMotor. Both inputs low is coasting."""

    def __init__(self, pos, neg, dead_time_us, pause_us, ticks_us):
        from adafruit_motor.motor import DCMotor  # in lib/ on the drive; no other bridge needs it

        self._motor = DCMotor(pos.io, neg.io)
        self._dead_time_us = dead_time_us
        self._pause_us = pause_us
        self._ticks_us = ticks_us
        self._direction = 0

    def cut(self):
        """No drive."""
        self._motor.throttle = None

    def cut_at(self, us):
        """Wait for this time (ticks), which must be near, and cut. Returns the time."""
        now_us = self._ticks_us()
        while ticks.diff(us, now_us) > 0:
            now_us = self._ticks_us()
        self.cut()
        return now_us

    def release(self):
        """No drive, coasting."""
        self._motor.throttle = None
        self._direction = 0

    def drive(self, duty):
        """Drive at duty, -255 ... 255 but not 0. Returns the time."""
        direction = 1 if duty > 0 else -1
        if direction != self._direction:
            self.release()
            self._direction = direction
            self._pause_us(self._dead_time_us)
        now_us = self._ticks_us()
        self._motor.throttle = duty / 255
        return now_us


class _Analog:
    """An analog input."""

    def __init__(self, number):
        import analogio  # a build may lack it, and a board file the input

        self.io = analogio.AnalogIn(_pin_of(number))

    def read(self):
        """The voltage, 0 ... 65535."""
        return self.io.value


def analog(number):
    """A function that reads analog input `number`, 0 ... 65535."""
    return _Analog(number).read


def reader(number):
    """A function that reads input pin `number` (False or True) against its pull-up; None for None."""
    if number is None:
        return None
    if number not in _inputs:
        io = digitalio.DigitalInOut(_pin_of(number))
        io.switch_to_input(digitalio.Pull.UP)
        _inputs[number] = io
    io = _inputs[number]
    return lambda: io.value


def on_rise(_number, _handler):
    """Do nothing: CircuitPython has no pin interrupts, so the loop polls the switches."""


def led(on):
    """The board's LED."""
    if _led is not None:
        _led.value = on


def find_board():
    """The board file by board_file.find_board() for this board_id, or None. Sets its LED up."""
    global _led
    found = board_file.find_board(pins.board_id, pins.board_id, os.listdir, sys.platform[:3] == "RP2")
    number = board_file.led_of(found, pins.board_id.endswith("_w")) if found else None
    if _led is None and number is not None:
        try:
            _led = digitalio.DigitalInOut(_pin_of(number))
            _led.switch_to_output(False)
        except (AttributeError, ValueError):
            pass  # no such pin, or it is in use
    return found


def motors_off(board):
    """Every drive pin low: the enables first, then the legs."""
    for number in shared.drive_pins(board):
        if number in _outputs:
            _outputs[number].low()
        else:
            output(number)


# ---- the USB serial channel


class _NoChannel:
    """The channel where boot.py has enabled none: no byte ever arrives."""

    connected = False
    in_waiting = 0
    out_waiting = 1024

    def readinto(self, _buffer):
        return 0

    def write(self, _data):
        return 0


_channel = usb_cdc.data or usb_cdc.console or _NoChannel()

_STOP = 0x21  # `!`
_GONE_MS = 16  # a host that has gone is noticed within this, though the loop sleeps longer
_OUTPUT = 64  # bytes: the smallest buffer for output that a USB device has; less than that waits if it can take more

_byte_in = bytearray(1)
_byte_out = bytearray(1)
_there = False  # whether a host was connected at the last check


def _prepare():
    """Make the channel non-blocking. Returns the ipoll() of a poll object for input.

    ipoll() allocates only for its first answer, which is given here, for output.
    """
    if isinstance(_channel, _NoChannel):
        return _no_input
    _channel.timeout = 0
    _channel.write_timeout = 0
    poll = select.poll()  # pyright: ignore[reportAttributeAccessIssue]
    poll.register(_channel, select.POLLOUT)  # pyright: ignore
    ipoll = poll.ipoll  # pyright: ignore[reportAttributeAccessIssue]
    for _ in ipoll(0):
        pass
    poll.modify(_channel, select.POLLIN)  # pyright: ignore
    return ipoll


def _no_input(_wait_ms):
    return ()


_ipoll_in = _prepare()
_readinto = _channel.readinto
_write = _channel.write


def any(wait_ms):
    """True as soon as a byte waits, or when the host has gone; False after wait_ms without one."""
    while True:
        for _ in _ipoll_in(min(wait_ms, _GONE_MS)):
            return True
        wait_ms -= _GONE_MS
        if _there != _channel.connected and _has_left():
            return True
        if wait_ms <= 0:
            return False


def drain(receiver, most):
    """Pass received bytes to Receiver.receive(): at most `most`, and none after a stop.

    Returns that stop, or NEED_BYTES.
    """
    taken = 0
    while taken < most and receiver.unparsed <= receiver.mask:
        if not _readinto(_byte_in):
            return receiver.receive(_STOP) if not taken and _take_leave() else 0
        taken += 1
        stop = receiver.receive(_byte_in[0])
        if stop:
            return stop
    return 0


def _has_left():
    """True if a host was connected and none is now. A host that has connected is noted."""
    global _there
    if _channel.connected:
        _there = True
        return False
    return _there


def _take_leave():
    """As _has_left(), once for each host that has left."""
    global _there
    left = _has_left()
    if left:
        _there = False
    return left


def writable():
    """True if write() will not lose its byte."""
    return _channel.out_waiting < _OUTPUT


def write(c):
    """Send byte c."""
    _byte_out[0] = c
    _write(_byte_out)


# ---- the chip


def unique_id():
    """The chip's own number, as hex (bytes)."""
    return binascii.hexlify(microcontroller.cpu.uid)


def boot_id():
    """A number that differs from boot to boot, 0 ... 2**30-1."""
    return int.from_bytes(os.urandom(4), "little") & 0x3FFFFFFF


def reset_cause():
    """Why the board started, as in codes.py."""
    reason = microcontroller.cpu.reset_reason
    if reason == microcontroller.ResetReason.WATCHDOG:
        return codes.WATCHDOG
    return codes.ASKED if reason == microcontroller.ResetReason.SOFTWARE else codes.POWER


def start_watchdog():
    """Start the watchdog. Returns the function that feeds it; call that every few seconds, or the board is reset."""
    dog = microcontroller.watchdog
    if dog is None:
        return stop_watchdog
    from watchdog import WatchDogMode  # a board without one may lack the module

    dog.timeout = _HUNG_S
    dog.mode = WatchDogMode.RESET
    return dog.feed


def stop_watchdog():
    """Stop the watchdog: at the prompt nothing feeds it."""
    if microcontroller.watchdog is not None:
        microcontroller.watchdog.mode = None


def encoder(number, pins):
    """The reader (encoders.py) of an axis whose pins name an encoder; None, after a printed line."""
    return circuitpython_encoder.reader(number, pins, _pin_of)


def collect():
    """Collect the garbage of the start; the loop makes none."""
    gc.collect()


def free_memory():
    """Free bytes of the heap. Allocates nothing, but walks the heap, which takes milliseconds."""
    return gc.mem_free()  # pyright: ignore[reportAttributeAccessIssue]


def uninterrupted(action, argument):
    """Call action(argument), again after each Ctrl-C, until it has returned: Ctrl-C cannot be switched off here."""
    while True:
        try:
            action(argument)
            return
        except KeyboardInterrupt:
            pass


def leave(board):
    """Turn motors and watchdog off before the prompt, whatever Ctrl-C interrupts."""
    uninterrupted(_leave, board)


def _leave(board):
    motors_off(board)
    stop_watchdog()
