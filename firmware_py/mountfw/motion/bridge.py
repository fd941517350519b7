"""H-bridge drivers. They take objects, not pins; the port makes those.

A bridge has three verbs. cut() takes the drive away in one go and touches nothing else; off() does that and leaves
every input in its defined state; drive(duty) drives at -255 ... 255, never 0, positive meaning the `pos` leg high, and
returns the time right before it did.

An output object has high(), low() and, where its duty can be set, level(duty_u16). high() and level() return the time
right before the pin changed, or None where the port does not know it. low() and high() are pin levels, never a PWM's
duty: the PWM hardware keeps the old duty to the end of its period.
"""

from mountfw import const

_FULL = const(255)
_U16 = const(257)  # 255 * 257 = 65535


class EnableBridge:
    """One enable that carries the duty, two direction legs: SN754410, L293D, TB6612.

    pause_us is the port's busy wait: dead_time_us between the legs' change and the enable.
    """

    def __init__(self, enable, pos, neg, dead_time_us, pause_us, ticks_us):
        self._enable = enable
        self._pos = pos
        self._neg = neg
        self._dead_time_us = dead_time_us
        self._pause_us = pause_us
        self._ticks_us = ticks_us
        self._direction = 0
        self.cut = enable.low

    def off(self):
        """No drive, coasting; both legs low."""
        self._enable.low()
        self._direction = 0
        self._pos.low()
        self._neg.low()

    def drive(self, duty):
        """Drive at duty, -255 ... 255 but not 0. Returns the time."""
        direction = 1 if duty > 0 else -1
        if direction != self._direction:
            self._enable.low()  # before a leg changes
            if direction > 0:
                self._neg.low()
                self._pos.high()
            else:
                self._pos.low()
                self._neg.high()
            self._direction = direction
            self._pause_us(self._dead_time_us)
        duty *= direction
        now_us = self._ticks_us()
        at_us = self._enable.high() if duty == _FULL else self._enable.level(duty * _U16)
        return now_us if at_us is None else at_us


class TwoPwmBridge:
    """Two inputs, each of which may carry the duty: DRV8833, DRV8871. Both low is coasting."""

    def __init__(self, pos, neg, dead_time_us, pause_us, ticks_us):
        self._pos = pos
        self._neg = neg
        self._dead_time_us = dead_time_us
        self._pause_us = pause_us
        self._ticks_us = ticks_us
        self._direction = 0

    def cut(self):
        """No drive."""
        self._pos.low()
        self._neg.low()

    def off(self):
        """No drive, coasting."""
        self._pos.low()
        self._neg.low()
        self._direction = 0

    def drive(self, duty):
        """Drive at duty, -255 ... 255 but not 0. Returns the time."""
        direction = 1 if duty > 0 else -1
        if direction != self._direction:
            self.off()
            self._direction = direction
            self._pause_us(self._dead_time_us)
        leg = self._pos if direction > 0 else self._neg
        duty *= direction
        now_us = self._ticks_us()
        at_us = leg.high() if duty == _FULL else leg.level(duty * _U16)
        return now_us if at_us is None else at_us
