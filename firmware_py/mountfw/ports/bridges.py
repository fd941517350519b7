"""H-bridge drivers. They take objects, not pins; the port makes those.

A bridge has five verbs. cut() takes the drive away in one go and touches nothing else; cut_at(us) waits for a time that
is near, cuts, and returns the time, or returns -1, not cut, as soon as a byte waits if it looks for one; release() cuts
and brings both legs low; drive(duty) drives at -255 ... 255, never 0, positive meaning the `pos` leg high, and returns
the time right before it did; tune(hz, slow) sets frequency and decay of the PWM, where made_hz is not 0. It is the
frequency as made.

In the PWM's pauses both legs are equal, or the motor coasts: slow decay, and fast decay. Without a drive it coasts, in
either. At duty 255 there are no pauses.

An output object has high(), low() and, where its duty can be set, level(duty_u16); where a port is TUNABLE also
set_hz(hz) and `shows`. high() and level() return the time right before the pin changed, or None where the port does not
know it. low() and high() are pin levels, never a PWM's duty: the PWM hardware keeps the old duty to the end of its
period.
"""

from mountfw import const
from mountfw.wire.ticks import diff

_FULL = const(255)
_U16 = const(257)  # 255 * 257 = 65535
_TURN_US = const(5)  # half a turn of cut_at()'s loop on an RP2040


def _carry(output, duty):
    """Bring an output to duty, 0 ... 255. Returns the time, or None."""
    if duty == _FULL:
        return output.high()
    return output.level(duty * _U16) if duty else output.low()


class Bridge:
    """Two legs; both low is coasting.

    pause_us is the port's busy wait: dead_time_us between the legs' change and the drive.
    """

    made_hz = 0

    def __init__(self, pos, neg, dead_time_us, pause_us, ticks_us):
        self._pos, self._neg = pos, neg
        self._dead_time_us = dead_time_us
        self._pause_us = pause_us
        self._ticks_us = ticks_us
        self._direction = 0
        self._slow = 0
        self._carriers = (pos, neg)  # outputs that may carry the duty

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

    def tune(self, hz, slow):
        """From the next drive on: PWM frequency, and slow decay (1) or fast (0). Nothing may drive."""
        self.release()
        for output in self._carriers:
            output.set_hz(hz)
        self._slow = slow


class TwoPwmBridge(Bridge):
    """Two inputs, each of which may carry the duty: DRV8833, DRV8871.

    Fast decay: the leg of the direction carries it, and the other one is low. Slow decay: that leg is high, and the
    other one carries the rest, in which both are high.
    """

    def drive(self, duty):
        """Drive at duty, -255 ... 255 but not 0. Returns the time."""
        direction = 1 if duty > 0 else -1
        if direction != self._direction:
            self.release()  # before a leg changes
            self._direction = direction
            self._pause_us(self._dead_time_us)
        duty *= direction
        leg = self._pos if direction > 0 else self._neg
        now_us = self._ticks_us()
        if self._slow:
            at_us = leg.high()
            _carry(self._neg if direction > 0 else self._pos, _FULL - duty)
        else:
            at_us = _carry(leg, duty)
        return now_us if at_us is None else at_us


class EnableBridge(Bridge):
    """One enable, two direction legs: SN754410, L293D; and TB6612, which brakes while its enable is low and a leg high.

    Fast decay: the enable carries the duty. Slow decay: the enable is high, and `pos` carries the duty; where `neg` is
    high, its pauses are the drive.
    """

    def __init__(self, enable, pos, neg, dead_time_us, pause_us, ticks_us):
        super().__init__(pos, neg, dead_time_us, pause_us, ticks_us)
        self._enable = enable
        self._carriers = (enable, pos)
        self.cut = enable.low

    def release(self):
        """No drive, coasting; both legs low."""
        super().release()
        self._pos.low()
        self._neg.low()

    def drive(self, duty):
        """Drive at duty, -255 ... 255 but not 0. Returns the time."""
        direction = 1 if duty > 0 else -1
        if direction != self._direction:
            self.release()  # before a leg changes
            (self._pos if direction > 0 else self._neg).high()
            self._direction = direction
            self._pause_us(self._dead_time_us)
        duty *= direction
        if self._slow:
            if not self._enable.shows:
                self._pos.low()  # else the period of a drive that was cut would go on, at its duty
            _carry(self._pos, duty if direction > 0 else _FULL - duty)
            duty = _FULL
        now_us = self._ticks_us()
        at_us = _carry(self._enable, duty)
        return now_us if at_us is None else at_us
