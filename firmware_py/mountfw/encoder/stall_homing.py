"""Homing without a switch: the end is where the motor stalls. Imports axis, codes.

    SEEK     run towards the end, at reduced duty, until it stalls
    BACK     run away from it for a fifth of a second, and through the play of gears: if no count comes there either, it
             is no end, but a motor that is stuck, or an encoder that does not count
    AGAIN    towards it again, until it stalls: that is the place

The axis drives, counts and ends the move; it says when the motor has stalled. In all it may drive for search_limit_ms.
"""

from mountfw import codes, const
from mountfw.motion.axis import DUE_SEARCH, DUE_SETTLE

_SEEK = const(1)
_BACK = const(2)
_AGAIN = const(3)

_SETTLE_US = const(50_000)
_BACK_US = const(200_000)


class StallHoming:
    """The search of one axis, in the place of a Homing."""

    def __init__(self, axis):
        self._axis = axis
        self._phase = 0
        self._direction = 0
        self._home = False
        self._duty = 0
        self._limit_us = 0

    def start(self, direction, home):
        """Begin; the axis has begun its move."""
        self._direction = direction
        self._home = home
        self._duty = self._axis.stall_duty
        self._limit_us = self._axis.search_limit_ms * 1000
        self._go(_SEEK)

    def stalled(self):
        """The motor has drive, and no count comes."""
        axis = self._axis
        if self._phase == _SEEK:
            self._phase = _BACK
            axis.handle(DUE_SETTLE, _SETTLE_US)
        elif self._phase == _AGAIN and axis.watch.turned():
            axis.abort(codes.DONE)
            if self._home:
                axis.position.homed()
        else:
            self._stuck()

    def _stuck(self):
        self._axis.abort(codes.HOMING_FAILED)
        self._axis.error(codes.AXIS_STALLED)

    def rested(self):
        """The rest is over."""
        self._go(self._phase)

    def over(self):
        """The drive has come to its end: that of the way back, or all that there may be."""
        if self._phase == _BACK and not self._axis.watch.turned():
            self._stuck()
        elif self._phase == _BACK and self._left_us() > 0:
            self._phase = _AGAIN
            self._axis.handle(DUE_SETTLE, _SETTLE_US)
        else:
            self._axis.abort(codes.HOMING_FAILED)
            self._axis.error(codes.AXIS_NOT_FOUND)

    def hit(self):
        """A switch ahead is open."""
        self._axis.abort(codes.END_STOP)

    def watch(self):
        """A switch has not ended this leg."""
        return False

    def _left_us(self):
        return self._limit_us - self._axis.drive.on_us

    def _go(self, phase):
        self._phase = phase
        axis = self._axis
        left_us = self._left_us()
        if left_us <= 0:
            self.over()
        elif phase == _BACK:
            axis.drive.aim(-self._direction * self._duty)
            back_us = _BACK_US + axis.reader.play_us * 255 // self._duty
            axis.handle(DUE_SEARCH, min(left_us, back_us))
        else:
            axis.drive.aim(self._direction * self._duty)
            axis.handle(DUE_SEARCH, left_us)
