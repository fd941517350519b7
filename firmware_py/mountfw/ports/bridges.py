"""H-bridge drivers. They take objects, not pins; the port makes those.

A bridge has four verbs. cut() takes the drive away in one go and touches nothing else; cut_at(us) waits for a time that
is near, cuts, and returns the time, or returns -1, not cut, as soon as a byte waits if it looks for one; release() cuts
and brings both legs low; drive(duty) drives at -255 ... 255, never 0, positive meaning the `pos` leg high, and returns
the time right before it did.

An output object has high(), low() and, where its duty can be set, level(duty_u16). high() and level() return the time
right before the pin changed, or None where the port does not know it. low() and high() are pin levels, never a PWM's
duty: the PWM hardware keeps the old duty to the end of its period.
"""

from mountfw import const
from mountfw.wire.ticks import diff

_FULL = const(255)
_U16 = const(257)  # 255 * 257 = 65535
_TURN_US = const(5)  # half a turn of cut_at()'s loop on an RP2040


class Bridge:
    """Two legs, and an enable that carries the duty; without one the leg that is high carries it. Both low is coasting.

    pause_us is the port's busy wait: dead_time_us between the legs' change and the drive.
    """

    def __init__(self, pos, neg, dead_time_us, pause_us, ticks_us, enable=None):
        self._pos, self._neg = pos, neg
        self._dead_time_us = dead_time_us
        self._pause_us = pause_us
        self._ticks_us = ticks_us
        self._direction = 0
        self._enable = enable
        self._carrier = enable or pos  # the output with the duty

    def cut(self):
        """No drive."""
        self._pos.low()
        self._neg.low()

    def cut_at(self, us):
        """Wait for this time (ticks), which must be near, and cut. Returns the time."""
        ticks_us = self._ticks_us
        now_us = ticks_us()
        while diff(us, now_us) > _TURN_US:
            now_us = ticks_us()
        self.cut()
        return now_us

    def release(self):
        """No drive, coasting; both legs low."""
        self.cut()
        self._direction = 0
        if self._enable:
            self._pos.low()
            self._neg.low()

    def drive(self, duty):
        """Drive at duty, -255 ... 255 but not 0. Returns the time."""
        direction = 1 if duty > 0 else -1
        if direction != self._direction:
            self.release()  # before a leg changes
            leg = self._pos if direction > 0 else self._neg
            if self._enable:
                leg.high()
            else:
                self._carrier = leg
            self._direction = direction
            self._pause_us(self._dead_time_us)
        duty *= direction
        now_us = self._ticks_us()
        at_us = self._carrier.high() if duty == _FULL else self._carrier.level(duty * _U16)
        return now_us if at_us is None else at_us


class TwoPwmBridge(Bridge):
    """Two inputs, each of which may carry the duty: DRV8833, DRV8871."""


class EnableBridge(Bridge):
    """One enable that carries the duty, two direction legs: SN754410, L293D, TB6612."""

    def __init__(self, enable, pos, neg, dead_time_us, pause_us, ticks_us):
        super().__init__(pos, neg, dead_time_us, pause_us, ticks_us, enable)
        self.cut = enable.low
