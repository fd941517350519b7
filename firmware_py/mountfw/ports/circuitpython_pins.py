"""A CircuitPython board's pins: outputs, bridges, inputs, and its board file.

boot.py imports this part of the port alone, before USB starts.
"""

import os
import sys

import board as pins
import digitalio
import microcontroller
import pwmio

from mountfw.ports import shared
from mountfw.wire.ticks import diff

# A new duty takes effect at the end of the PWM's period (RP2040 data sheet 4.5.2). Off is a duty here: to drive the pin
# as a level, CircuitPython needs a new object. So no period is longer than 50 us, whatever the board file says.
_LEAST_PWM_HZ = 20_000
PERIOD_US = 50

_gpios = getattr(microcontroller, "pin")  # noqa: B009 (CircuitPython's stubs do not know it)
_outputs = {}  # {pin: its output}; CircuitPython reserves a pin until deinit() of its object
_inputs = {}
_led = None


def pin_of(number):
    """GPIO `number`, or the pin of that name in the module `board`."""
    return getattr(pins, number) if isinstance(number, str) else getattr(_gpios, "GPIO%d" % number)


class _Level:
    """An output that is high or low."""

    def __init__(self, number):
        self.io = digitalio.DigitalInOut(pin_of(number))
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
        self.io = pwmio.PWMOut(pin_of(number), duty_cycle=0, frequency=max(pwm_hz, _LEAST_PWM_HZ))

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
        while diff(us, now_us) > 0:
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


def reader(number):
    """A function that reads input pin `number` (False or True) against its pull-up; None for None."""
    if number is None:
        return None
    if number not in _inputs:
        io = digitalio.DigitalInOut(pin_of(number))
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
    from mountfw import board_file  # needed at the start only

    global _led
    found = board_file.find_board(pins.board_id, pins.board_id, os.listdir, sys.platform[:3] == "RP2")
    number = board_file.led_of(found, pins.board_id.endswith("_w")) if found else None
    if _led is None and number is not None:
        try:
            _led = digitalio.DigitalInOut(pin_of(number))
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
