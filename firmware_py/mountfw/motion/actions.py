"""What the settings of an axis make of it, and the actions of its table: begin, drive, count, end.

An action takes the value of its event. It returns True if the table's next state is right; False if the state stays,
or another event was handled meanwhile. Which action is due when stands in axis.py alone.
"""

from mountfw import codes, const
from mountfw.motion.drive import Drive
from mountfw.motion.position import EDGE, Position
from mountfw.settings import MAX_STEPS, Settings
from mountfw.wire.ticks import add

_SHORT_US = const(1_500)  # a drive that may be over before the loop comes round is waited for where it begins
_COUNT_US = const(1_000_000)  # a run is counted so often, so that its sums stay small, or more often: within
_COUNT_STEPS = const(100)  # so many steps at duty 1, so that it ends where no more can be counted


class Actions(Settings):
    """An axis's settings as its attributes, its drive, and the move under way. Arguments as of Axis."""

    def __init__(self, number, bridge, positive_stop, negative_stop, homing, error_queue, ticks_us, position=None):
        self.number = number
        self.positive_stop = positive_stop
        self.negative_stop = negative_stop
        self._errors = error_queue
        self._ticks_us = ticks_us
        self.position = position or Position()
        self.drive = Drive(bridge, [negative_stop, positive_stop, negative_stop], ticks_us)  # [0] stands for none
        self.switch_homing = self.homing = homing and homing(self)  # the homing of this axis, and the one under way
        self.has_moved = False  # has a move ended, or was its position defined, since store.py asked last?
        self.poll_input = bool  # nothing: the App sets its own, by which a stop in the middle of longer work cuts
        self.inverted = 0
        self.reset()

    def reset(self):
        """Off, and everything as at power-up."""
        self.drive.reset()
        self.state = 0
        self.load(())
        self.position.reset()
        self.last_relative = 0  # steps

        # how the last move ended
        self.reason = codes.NONE_YET
        self.ended_steps = self.ended_on_us = 0

        # the move under way
        self.ends_as = codes.DONE  # its reason if it comes to its own end
        self.pulses_left = self.period_us = 0
        self.length_us = 0  # of its pulses, but for the backlash's
        self.next_at = 0  # when its rest is over
        self.resting = False  # is the period of the last pulse still running, whether or not a move is under way?
        self.counting = False  # is a drive that is over being counted?

    # ---- settings

    def apply(self):
        """The settings have changed."""
        self.positive_stop.fitted = self.switches & 1 != 0
        self.negative_stop.fitted = self.switches & 2 != 0
        self.drive.watched = self.switches & 3 != 0 and not self.checking & 1
        self.drive.inverted = self.inverted
        self.drive.stops[1], self.drive.stops[-1] = self.stop_towards(1), self.stop_towards(-1)
        self.changed = self.state != 0  # then _close() measures
        if not self.changed:
            self._measure()

    def _measure(self):
        """Compute the amounts of drive that make a step, and the gap: at rest, for a change is the next move's."""
        self.position.scale(self.pulse_us * self.step_duty, self.take_up_us * self.step_duty)
        self.count_us = min(self.position.step, _COUNT_US // _COUNT_STEPS) * _COUNT_STEPS

    # ---- the end-stops

    def limits(self):
        """Bit 0: positive end-stop active, bit 1: negative, bit 2: home. Switches not fitted read 0."""
        return self.switches & 3 and self.stop_towards(1).active() | self.stop_towards(-1).active() << 1

    def stop_towards(self, direction):
        """The end-stop in the axis's own direction 1 or -1: `inverted` swaps names, not switches."""
        return self.positive_stop if (direction > 0) != (self.inverted > 0) else self.negative_stop

    # ---- errors, and what may not be

    def error(self, number):
        """Queue error `number` of this axis."""
        self._errors.push(self.number * 100 + number)

    def error_of(self, reason, direction):
        """Queue the error of a reason in that direction, if it has one."""
        errors = codes.REASON_ERRORS.get(reason)
        if errors:
            self.error(errors[0 if direction > 0 else -1])

    def may_begin(self, _value):
        """May a move begin? If not, an error says why."""
        if self.motor_type and not self.drive.emergency:
            return True
        self.error(codes.AXIS_EMERGENCY_STOP if self.drive.emergency else codes.AXIS_NOT_CONNECTED)
        return False

    def out_of_reach(self, low, high):
        """True, with its error queued, if a target between these steps is not allowed."""
        if low < -MAX_STEPS or high > MAX_STEPS:
            self.error(codes.AXIS_OUT_OF_RANGE)
        elif self.checking & 8 and high > self.soft_maximum:
            self.error_of(codes.SOFT_LIMIT, 1)
        elif self.checking & 8 and low < self.soft_minimum:
            self.error_of(codes.SOFT_LIMIT, -1)
        else:
            return False
        return True

    def refuse(self, _value):
        """A move is under way."""
        self.error(codes.AXIS_MOVING)
        return False

    def cannot_happen(self, _value):
        """The loop turns this into an internal fault: all off, error 64."""
        raise RuntimeError

    # ---- begin

    def begin(self, speed):
        """A move is accepted: from here on it must reach _close()."""
        self.drive.aim(speed)
        self.drive.on_us = 0
        self.position.begin()
        return True

    def supersede(self, speed):
        """The move ends, and a frame's begins. The drive stays on: the new one may go the same way."""
        drive = self.drive
        goes_on = drive.measuring and not drive.was_cut and speed * drive.direction > 0
        self._close(codes.SUPERSEDED)
        drive.measuring = goes_on
        return self.begin(speed)

    def turn_on(self, us):
        """Drive for us at most. If the gate forbids it, the move ends."""
        self.resting = False
        drive = self.drive
        reason = drive.on(us)
        if reason:
            self.forbidden(reason)  # pyright: ignore[reportAttributeAccessIssue] (Axis makes an event of it)
        elif us < _SHORT_US:
            drive.end_on_time(self.poll_input, 1)
        return not reason

    # ---- a drive is over

    def taken_up(self, _value):
        """Count a whole take-up. The rest after it is that between two steps: a motor still turning adds to a step."""
        self.counting = True
        drive = self.drive
        drive.off()
        drive.measured_us(True)
        self.position.taken_up(drive.direction)
        self.next_at = add(drive.cut_at, self.period_us - self.length_us)
        self.counting = False
        return True

    def pulsed(self, _value):
        """Count a whole pulse: a step, or by its time if its length is its own. Its period goes on."""
        self.counting = True
        drive = self.drive
        drive.off()
        drive.measured_us(True)
        if self.length_us == self.pulse_us:
            self.position.pulsed(drive.direction)
        else:  # an estimate: half the time is not half the way
            self.position.driven(drive.direction, self.length_us * drive.duty, True)
        self.pulses_left -= 1
        self.keep_period()
        self.counting = False
        return True

    def last_pulsed(self, _value):
        """Count the last pulse, and end the move: DONE or STOPPED, which queue no error."""
        self.pulsed(0)
        self._close(self.ends_as)
        return True

    def settle(self, us):
        """Off for us, in the middle of homing."""
        self.drive.off()
        self.count(True)
        self.next_at = add(self._ticks_us(), us)
        return True

    # ---- end

    def make_last(self, reason):
        """This pulse is the last one."""
        if self.pulses_left > 1:
            self.pulses_left = 1
            self.ends_as = reason
        return True

    def cut_short(self, reason):
        """Off in the middle of a pulse, which has its period all the same; and the move is over."""
        self.drive.off()
        self.keep_period()
        return self.finish(reason)

    def finish(self, reason):
        """Off, and the move is over."""
        self.drive.off()
        self._close(reason)
        if reason == codes.RUN_LIMIT and self.position.millisteps * self.drive.direction >= EDGE:
            self.error(codes.AXIS_OUT_OF_RANGE)
        else:
            self.error_of(reason, self.drive.direction)
        return True

    def _close(self, reason):
        """Count what the move has driven, and note how it ended."""
        self.counting = True
        self.count(True)
        self.ended_steps = self.position.made
        self.ended_on_us = self.drive.on_us
        self.reason = reason
        self.has_moved = True
        self.counting = False
        if self.changed:
            self.changed = False
            self._measure()

    # ---- count

    def count(self, over):
        """Count the on-time since it was counted last, if there is any."""
        drive = self.drive
        if drive.measuring:
            self.position.driven(drive.direction, drive.measured_us(over) * drive.duty, over)

    def keep_period(self):
        """The next pulse must wait until this one's period is over."""
        self.next_at = add(self.drive.on_at, self.period_us)
        self.resting = True
