"""Homing: finds an end-stop, at the same place each time. Imports axis, codes.

    FAST       run towards the switch until it opens
    CONFIRM    at rest: is it still open? If not, it was a bump, and the run goes on
    BACK       run away from it until it closes
    RELEASED   at rest: is it still closed?
    SLOW       towards it in short pulses; where it opens is the place

The axis drives, counts and ends the move; this file only decides the next leg. All legs together drive for at most
search_limit_ms. If the switch at the other end opens meanwhile, the wiring is wrong, and the search fails. build.py
loads this file where a board file has an input for a switch.
"""

from mountfw import codes, const
from mountfw.motion.axis import DUE_SEARCH, DUE_SETTLE

_FAST = const(1)
_CONFIRM = const(2)
_BACK = const(3)
_RELEASED = const(4)
_SLOW = const(5)

_SETTLE_US = const(20_000)  # at rest before a switch is believed: contacts bounce for some milliseconds
_BACK_OFF_STEPS = const(20)  # a switch must close within so many steps, or it never will
_SLOW_PART = const(8)  # a slow pulse is a step's pulse divided by this
_SHORTEST_US = const(200)


class Homing:
    """The search of one axis."""

    def __init__(self, axis):
        self._axis = axis
        self._phase = 0
        self._direction = 0
        self._home = False
        self._other_was_closed = False
        # the settings it began with: new ones are the next move's
        self._run_duty = 0
        self._step_duty = 0
        self._limit_us = 0
        self._back_off_us = 0

    def start(self, direction, home):
        """Begin; the axis has begun its move."""
        self._direction = direction
        self._home = home
        self._other_was_closed = False
        axis = self._axis
        self._run_duty = axis.run_duty
        self._step_duty = axis.step_duty
        self._limit_us = axis.search_limit_ms * 1000
        self._back_off_us = axis.pulse_us * _BACK_OFF_STEPS + axis.take_up_us
        self._go(_FAST)

    # ---- events of the axis

    def hit(self):
        """The switch ahead has opened, and must not be driven into."""
        if self._phase == _BACK:
            self._wrong_end()
        elif self._phase == _SLOW:
            self._axis.abort(codes.DONE)
            if self._home:
                self._axis.position.homed()
        else:
            self._phase = _CONFIRM
            self._axis.handle(DUE_SETTLE, _SETTLE_US)

    def watch(self):
        """While it drives: True if a switch has ended this leg."""
        if self._phase == _BACK:
            if self._opened(self._direction):
                return False
            self._phase = _RELEASED
            self._axis.handle(DUE_SETTLE, _SETTLE_US)
            return True
        if not self._opened(-self._direction):
            self._other_was_closed = True
            return False
        if self._other_was_closed:
            self._wrong_end()
        elif self._axis.drive.on_us > self._back_off_us:
            self._fail(codes.AXIS_NOT_RELEASED)
        else:
            return False
        return True

    def rested(self):
        """The rest is over."""
        if self._phase == _SLOW:
            self._go(_SLOW)
        elif self._opened(self._direction):
            self._go(_BACK)
        else:
            self._go(_FAST if self._phase == _CONFIRM else _SLOW)

    def over(self):
        """The leg is over: a slow pulse, or all the drive that there may be."""
        if self._phase == _SLOW and self._left_us() > 0:
            self._axis.handle(DUE_SETTLE, max(self._slow_us(), _SETTLE_US))
        else:
            self._fail(codes.AXIS_NOT_RELEASED if self._phase == _BACK else codes.AXIS_NOT_FOUND)

    # ---- inside

    def _go(self, phase):
        self._phase = phase
        left_us = self._left_us()
        if left_us <= 0:
            self.over()
        elif phase == _FAST:
            self._leg(left_us, self._direction * self._run_duty)
        elif phase == _BACK:
            self._leg(min(left_us, self._back_off_us), -self._direction * self._run_duty)
        else:
            self._leg(min(left_us, self._slow_us()), self._direction * self._step_duty)

    def _leg(self, us, speed):
        self._axis.drive.aim(speed)
        self._axis.handle(DUE_SEARCH, us)

    def _left_us(self):
        return self._limit_us - self._axis.drive.on_us

    def _opened(self, direction):
        return self._axis.stop_towards(direction).active()

    def _slow_us(self):
        return max(self._axis.pulse_us // _SLOW_PART, _SHORTEST_US)

    def _fail(self, error):
        self._axis.abort(codes.HOMING_FAILED)
        self._axis.error(error)

    def _wrong_end(self):
        self._axis.abort(codes.HOMING_FAILED)
        self._axis.error_of(codes.END_STOP, -self._direction)
