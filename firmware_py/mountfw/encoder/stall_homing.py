"""Homing without a switch: the end is where the motor stalls. Imports codes.

    SEEK     run towards the end, at reduced duty, until it stalls
    BACK     run away from it for a fifth of a second: if it stalls there, too, it is no end, but a motor that is stuck
    AGAIN    towards it again, until it stalls: that is the place

The axis drives, counts and ends the move; it says when the motor has stalled. In all it may drive for search_limit_ms.
"""

from mountfw import codes, const

_SEEK = const(1)
_BACK = const(2)
_AGAIN = const(3)

_SETTLE_US = const(50_000)
_BACK_US = const(200_000)


class StallHoming:
    """The search of one axis, in the place of a Homing. phase is 0 while there is none."""

    def __init__(self, axis):
        self._axis = axis
        self.phase = 0
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
        if self.phase == _SEEK:
            self.phase = _BACK
            axis.settle_for(_SETTLE_US)
        elif self.phase == _AGAIN:
            axis.abort(codes.DONE)
            if self._home:
                axis.position.homed()
        else:
            axis.abort(codes.HOMING_FAILED)
            axis.error(codes.AXIS_STALLED)

    def rested(self):
        """The rest is over."""
        self._go(self.phase)

    def ran_out(self):
        """The drive has come to its end: that of the way back, or all that there may be."""
        if self.phase == _BACK and self._left_us() > 0:
            self.phase = _AGAIN
            self._axis.settle_for(_SETTLE_US)
        else:
            self._axis.abort(codes.HOMING_FAILED)
            self._axis.error(codes.AXIS_NOT_FOUND)

    def hit(self):
        """A switch ahead is open."""
        self._axis.abort(codes.END_STOP)
        self._axis.error_of(codes.END_STOP, self._axis.drive.direction)

    def watch(self):
        """A switch has not ended this leg."""
        return False

    def _left_us(self):
        return self._limit_us - self._axis.drive.on_us

    def _go(self, phase):
        self.phase = phase
        axis = self._axis
        left_us = self._left_us()
        if left_us <= 0:
            self.ran_out()
        elif phase == _BACK:
            axis.drive_for(min(left_us, _BACK_US), -self._direction, self._duty, False)
        else:
            axis.drive_for(left_us, self._direction, self._duty, False)
