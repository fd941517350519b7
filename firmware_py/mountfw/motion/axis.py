"""One axis: timed pulses, runs, frames and their bounds. Imports errors, homing, parameters, position, ticks.

A move is started by steps(), run(), frame() or seek() and carried on by service(), which never waits.
Every accepted move ends exactly once, through _finish(), with one of the reasons of codes.py.
All driving goes through _drive(), after _may_drive() has looked at the switches and at the stops that
are about to be parsed. Times are microseconds of a clock that wraps (ticks.py); what a drive was worth
is counted by position.py.

The clock is asked right before each pin write, the one that drives and the one that cuts, so that
an on-time is what the pin had: what comes between clock and pin is the same on both sides. A drive
that must end on time is waited for with cut_on_time(); what service() finds overdue ends late.

Two things may come from an interrupt, between any two lines here: guard(), and `emergency` set.
They cut the drive and leave the rest to service(); _started() looks again after it was driven.
"""

from mountfw import codes
from mountfw.motion.axis_settings import AxisSettings
from mountfw.motion.homing import Homing
from mountfw.motion.position import MAX_STEPS
from mountfw.wire.ticks import add, diff

# states of an axis, in such an order that those above REST have drive
IDLE = 0
REST = 1  # between two steps
PULSE = 2  # driving, one step or a take-up
RUN = 3  # driving until told otherwise

NEVER_US = 1 << 29  # "no deadline"

_FINISH_PULSE_US = 250_000  # a soft stop lets a pulse end that has less than this to go
_SHORTEST_US = 200  # no pulse is shorter, so less than that is not taken up
_SHORT_US = 900  # a pulse that may be over before the loop comes round is waited for where it begins
_TURN_US = 5  # half of what one turn of that waiting takes an RP2040
_MOST_ON_US = 1_000_000_000  # a move's time under drive is counted up to here: its sum stays a small integer
_COUNT_US = 20_000  # a run is counted at least this often while it is served, so that its sums stay small


def _nothing():
    pass


class Axis(AxisSettings):
    """Axis number (1 or 2) on a bridge, with its two EndStops named for the electrical direction.

    ticks_us is the clock. error_queue takes this axis's errors.
    """

    def __init__(self, number, bridge, positive_stop, negative_stop, error_queue, ticks_us):
        super().__init__(positive_stop, negative_stop)
        self.number = number
        self.bridge = bridge
        self._errors = error_queue
        self._ticks_us = ticks_us
        self.homing = Homing(self)
        self.forget = _nothing  # takes the position off the flash, where it is recorded; settings.py sets it
        self.recorded = False  # is it there, or on its way? Then nothing may drive before forget()
        self.has_moved = False  # has a move ended since settings.py looked last?
        self.reset()

    def reset(self):
        """Off, and everything as at power-up."""
        self.bridge.off()
        self.state = IDLE
        self.factory()
        self.apply()
        self.position.reset()
        self.last_relative = 0  # steps

        # how the last move ended
        self.reason = codes.NONE_YET
        self.ended_steps = 0
        self.ended_on_us = 0

        # what must not be: nothing may start while one of these is set
        self.held = codes.NONE_YET  # the reason of a stop that was received but not yet parsed
        self.emergency = False  # the emergency stop was hit; may be set by an interrupt

        # the move under way
        self.ends_at = 0  # while driving: when the drive ends by itself
        self.was_cut = False  # while driving: is it off already, since _cut_at?
        self.homing.phase = 0
        self._direction = 0
        self._duty = 0
        self._steps_left = 0
        self._on_us = 0
        self._stopping = False
        self._taking_up = False  # is this pulse for the backlash?
        self._length_us = 0  # of this move's pulses, but for the backlash's
        self._period_us = 0
        self._ends_as = codes.DONE  # why this run ends if nothing ends it earlier
        self._on_at = 0  # when the drive began
        self._led = False  # has lead() driven already, since _led_at?
        self._led_at = 0
        self._led_speed = 0
        self._cut_at = 0
        self._tripped = False  # has guard() cut it?
        self._counted_at = 0  # up to when a run is counted
        self._counting = False  # is a drive that is over being counted?
        self.resting = False  # after a move's last pulse, until _next_at
        self._next_at = 0

    # ---- what it is doing

    def driving(self):
        """True while the motor has drive."""
        return self.state > REST

    def direction(self):
        """-1, 0 or 1: where the move under way goes."""
        return self._direction if self.state else 0

    def position_now(self):
        """Millisteps, with the part of a step that a run has covered so far."""
        if self.state != RUN:
            return self.position.millisteps
        self._count(self._cut_at if self.was_cut else self._ticks_us())
        return self.position.now(self._direction)

    def whole_steps(self):
        """The same, rounded to steps, halves away from zero."""
        p = self.position_now()
        return (p + 500) // 1000 if p >= 0 else -((500 - p) // 1000)

    def driven_us(self):
        """How long the move under way has driven, as far as it is counted."""
        return self._on_us

    # ---- starting

    def steps(self, n):
        """Move by n steps: n pulses, each with its rest. False if refused (an error says why)."""
        if self._refused():
            return False
        position = self.position
        target = self.whole_steps() + n
        if not self._in_reach(target):
            return False
        self.last_relative = n
        position.target = target
        self._steps_left = abs(n)
        self._stopping = False
        self._begin(n, self.step_duty)
        if n == 0:
            self._finish(codes.DONE)
        else:
            self._first_pulse(self.pulse_us)
        return True

    def one_pulse(self, us):
        """Move by one pulse of its own length: 200 ... 2 000 000 us, either way. False if refused."""
        if self._refused():
            return False
        position = self.position
        direction = 1 if us > 0 else -1
        target = position.millisteps + direction * position.worth(abs(us) * self.step_duty)
        if not self._in_reach_of_pulse(target):
            return False
        position.target = (target + 500) // 1000 if target >= 0 else -((500 - target) // 1000)
        self._steps_left = 1
        self._stopping = False
        self._begin(direction, self.step_duty)
        self._first_pulse(abs(us))
        return True

    def _first_pulse(self, us):
        """Give the first pulse of a move whose pulses are so long, after the rest that the pulse before still has.

        At the prompt that one may be so long ago that time wrapped.
        """
        rest_us = 100_000_000 // self.possible_velocity() - self.pulse_us
        before_us = self._length_us + rest_us
        self._length_us = us
        self._period_us = us + rest_us
        self._next_at = add(self._on_at, before_us)
        if self.resting and 0 < diff(self._next_at, self._ticks_us()) <= before_us:
            self.state = REST
        else:
            self._pulse()

    def _in_reach_of_pulse(self, millisteps):
        """May one pulse of its own length go there? If not, an error says why."""
        if not -MAX_STEPS * 1000 <= millisteps <= MAX_STEPS * 1000:
            self.error(codes.AXIS_OUT_OF_RANGE)
        elif self.checking & 8 and millisteps > self.soft_maximum * 1000:
            self.error(codes.AXIS_POSITIVE_SOFT)
        elif self.checking & 8 and millisteps < self.soft_minimum * 1000:
            self.error(codes.AXIS_NEGATIVE_SOFT)
        else:
            return True
        return False

    def _in_reach(self, target):
        """May a target be asked for? If not, an error says why. No time bounds the move: its steps do."""
        if not -MAX_STEPS <= target <= MAX_STEPS:
            self.error(codes.AXIS_OUT_OF_RANGE)
        elif self.checking & 8 and target > self.soft_maximum:
            self.error(codes.AXIS_POSITIVE_SOFT)
        elif self.checking & 8 and target < self.soft_minimum:
            self.error(codes.AXIS_NEGATIVE_SOFT)
        else:
            return True
        return False

    def to(self, steps):
        """Move to a position, by the nearest whole number of pulses. False if refused."""
        if not -MAX_STEPS <= steps <= MAX_STEPS:
            self.error(codes.AXIS_OUT_OF_RANGE)
            return False
        part = self.position.millisteps % 1000
        n = steps - self.position.millisteps // 1000
        if part > 500 or (part == 500 and n <= 0):  # halves go away from zero
            n -= 1
        if not self.steps(n):
            return False
        self.position.target = steps
        return True

    def run(self, direction):
        """Run in direction 1 or -1 until stopped, at most run_limit_ms and to the soft limit. False if refused."""
        if self._refused():
            return False
        most_us = self.run_limit_ms * 1000
        ends_as = codes.RUN_LIMIT
        if self.checking & 8:
            limit = self.soft_maximum if direction > 0 else self.soft_minimum
            left_us = self.position.drive_to(limit, direction, self.run_duty)
            if left_us <= 0:
                self._soft_error(direction)
                return False
            if left_us < most_us:
                most_us = left_us
                ends_as = codes.SOFT_LIMIT
        self._begin(direction, self.run_duty)
        self._ends_as = ends_as
        self._run(most_us, False)
        return True

    def seek(self, direction, home):
        """Find the end-stop in direction 1 or -1; with home, position 0 is there. False if refused."""
        if self._refused():
            return False
        if not (self.watched and self.stop_towards(direction).fitted):
            self.error(codes.AXIS_NOT_FITTED)
            return False
        self._begin(direction, self.run_duty)
        self.homing.start(direction, home)
        return True

    def lead(self, speed):
        """Drive at a frame's speed (not 0) now, if nothing speaks against it. frame() must follow: it does the rest.

        So both motors get a frame's speeds before the longer work of counting begins.
        """
        if not (self.held or self.emergency or self.watched or self.recorded):
            self._led_speed = speed
            self._led_at = self._drive(speed)
            self._led = True

    def frame(self, speed, for_ms=0):
        """Obey a frame: drive at speed, -255 ... 255; 0 is off. Takes over from any move. False if refused.

        With for_ms (at most run_limit_ms) it is done after that time; else it runs as run() does.
        """
        if speed == 0:
            self.end(codes.SUPERSEDED)
            return True
        if self.emergency:
            self.end(codes.EMERGENCY_STOP)
            self.error(codes.AXIS_EMERGENCY_STOP)
            return False
        same_way = False
        if self.state:
            same_way = self.state > REST and (speed > 0) == (self._direction > 0)
            self._close(codes.SUPERSEDED)  # the drive stays on, the new one may go the same way
        self._begin(speed, speed if speed > 0 else -speed)
        if 0 < for_ms <= self.run_limit_ms:
            self._ends_as = codes.DONE
            self._run(for_ms * 1000, same_way)
        else:
            self._ends_as = codes.RUN_LIMIT
            self._run(self.run_limit_ms * 1000, same_way)
        return True

    # ---- ending

    def end(self, reason):
        """End the move now, if there is one."""
        if self._counting:  # Ctrl-C, or a fault, came in the middle of that
            self._counting = False
            self.position.certainty = codes.UNKNOWN
        if self.state:
            self._finish(reason)
        if self._led:  # a frame has driven since, and nobody else will count that
            self._led = False
            us = diff(self._ticks_us(), self._led_at)
            self.position.driven(1 if self._led_speed > 0 else -1, us * abs(self._led_speed), True)

    def stop_soon(self):
        """End the move; a pulse that is nearly over is finished first."""
        left_us = diff(self.ends_at, self._ticks_us())
        if self.state == PULSE and left_us < _FINISH_PULSE_US and not (self._taking_up or self.homing.phase):
            self._stopping = True
        else:
            self.end(codes.STOPPED)

    # ---- carrying on

    def service(self, now_us):
        """Do what is due. Returns the microseconds to the next deadline, or NEVER_US."""
        if not self.state:
            if self.resting:
                self.resting = diff(self._next_at, now_us) > 0
            return NEVER_US
        if self.emergency:
            self._finish(codes.EMERGENCY_STOP)
            self.error(codes.AXIS_EMERGENCY_STOP)
            return NEVER_US
        if self.state == REST:
            left_us = diff(self._next_at, now_us)
            if left_us > 0:
                return left_us
            if self.homing.phase:
                self.homing.rested()
            else:
                self._pulse()
            return self._next_us()
        if self.watched and (self._at_stop() or (self.homing.phase and self.homing.watch())):
            return self._next_us()
        left_us = diff(self.ends_at, now_us)
        if left_us <= 0 or (self.was_cut and not self._tripped):  # what guard() has just cut is for the next pass
            self._over()
            return self._next_us()
        if self.state == RUN and diff(now_us, self._counted_at) >= _COUNT_US:
            self._count(now_us)
        if self.position.is_at_edge and self.state == RUN and self.position.millisteps * self._direction > 0:
            self._finish(codes.RUN_LIMIT)
            self.error(codes.AXIS_OUT_OF_RANGE)
            return NEVER_US
        return left_us

    def _next_us(self):
        """Until the next thing to do."""
        if not self.state:
            return NEVER_US
        return diff(self._next_at if self.state == REST else self.ends_at, self._ticks_us())

    def left_us(self, now_us):
        """Until the drive ends by itself; NEVER_US if there is none, or it is cut already."""
        if self.state > REST and not self.was_cut:
            return diff(self.ends_at, now_us)
        return NEVER_US

    def cut_on_time(self):
        """Wait for the end of the drive, which must be near, and cut it; service() does the rest."""
        ticks_us = self._ticks_us
        cut = self.bridge.cut
        at = self.ends_at
        now_us = ticks_us()
        while diff(at, now_us) > _TURN_US:
            now_us = ticks_us()
        cut()
        if not self.was_cut:  # by guard(), meanwhile
            self._cut_at = now_us
            self.was_cut = True

    def guard(self, _pin):
        """An end-stop has opened (a hard interrupt, maybe): cut the drive that goes into it."""
        if self.watched and self.stop_towards(self._direction).active():
            self._tripped = True
            self._cut()

    # ---- what homing does

    def leg(self, direction, duty, most_us):
        """Run on in direction 1 or -1, at most for so long; then homing.ran_out() is told."""
        self._direction = direction
        self._duty = duty
        self.was_cut = False
        self._tripped = False
        self._run(most_us, False)

    def pulse(self, direction, duty, us):
        """Give one pulse of this length; then homing.ran_out() is told."""
        self._direction = direction
        self._duty = duty
        self.was_cut = False
        self._tripped = False
        self._one_pulse(us)

    def rest(self, us):
        """Off; then homing.rested() is told."""
        self.bridge.off()
        self._book()
        self._next_at = add(self._ticks_us(), us)
        self.state = REST

    def finish(self, reason):
        """Off, and the move is over."""
        self._finish(reason)

    def error(self, number):
        """Queue error `number` of this axis."""
        self._errors.push(self.number * 100 + number)

    # ---- inside

    def _refused(self):
        if self.state:
            self.error(codes.AXIS_MOVING)
        elif self.emergency:
            self.error(codes.AXIS_EMERGENCY_STOP)
        elif not self.motor_type:
            self.error(codes.AXIS_NOT_CONNECTED)
        else:
            return False
        return True

    def _soft_error(self, direction):
        self.error(codes.AXIS_POSITIVE_SOFT if direction > 0 else codes.AXIS_NEGATIVE_SOFT)

    def _begin(self, direction, duty):
        """A move is accepted: from here on it must reach _finish() or _close()."""
        self.position.made = 0
        self._direction = 1 if direction > 0 else -1
        self._duty = duty
        self._on_us = 0
        self.was_cut = False
        self._tripped = False

    def _drive(self, duty):
        """The one setter: drive at duty, -255 ... 255 but not 0, in the axis's own direction. Returns the time."""
        return self.bridge.drive(-duty if self.inverted else duty)

    def _started(self, duty):
        """Drive as _drive() does. False, with the move ended, if it must not."""
        if not self._may_drive():
            return False
        self._on_at = self._drive(duty)
        if self._tripped or self.held or self.emergency:  # meanwhile, by an interrupt or a look at the input
            return self._may_drive()
        return True

    def _may_drive(self):
        """False, with the move ended, if something forbids it."""
        if not (self.held or self.emergency or self.watched or self.recorded):
            return True
        if self.recorded:
            self.forget()  # which takes long, and looks at the input after it
        if self.held:
            self._finish(self.held)
        elif self.emergency:
            self._finish(codes.EMERGENCY_STOP)
            self.error(codes.AXIS_EMERGENCY_STOP)
        elif self.recorded:  # still: after a power cut that record would tell a wrong position
            self._finish(codes.FAULT)
        else:
            return not self._at_stop()
        return False

    def _at_stop(self):
        """True, with the move ended and its error queued, if a switch forbids this direction."""
        if not self.watched:
            return False
        if not (self._tripped or self.stop_towards(self._direction).active()):
            return False
        if self.stop_towards(-self._direction).active():
            self._finish(codes.FAULT)
            self.error(codes.AXIS_BOTH_STOPS)
        elif self.homing.phase:
            self.homing.hit()
        else:
            self._finish(codes.END_STOP)
            self.stop_error(self._direction)
        return True

    def stop_error(self, direction):
        """Queue the error of the end-stop in this direction."""
        self.error(codes.AXIS_POSITIVE_STOP if direction > 0 else codes.AXIS_NEGATIVE_STOP)

    def _cut(self):
        self._cut_at = self._ticks_us()
        self.bridge.cut()
        self.was_cut = True

    def _pulse(self):
        """The next pulse of a move by steps: first one for the backlash, if there is any to take up."""
        us = self.position.take_up(self._direction) // self._duty
        self._taking_up = us >= _SHORTEST_US
        self.was_cut = False
        self._one_pulse(us if self._taking_up else self._length_us)

    def _one_pulse(self, us):
        self.resting = False
        if self._started(self._duty * self._direction):
            self.ends_at = add(self._on_at, us)
            self.state = PULSE
            if us < _SHORT_US:
                self.cut_on_time()

    def _run(self, most_us, same_way):
        self.resting = False
        if self._led:  # a frame that drives already
            self._led = False
            self._on_at = self._led_at
            if (self._tripped or self.held or self.emergency) and not self._may_drive():
                return
        elif not self._started(self._duty * self._direction):
            return
        self.ends_at = add(self._on_at, most_us)
        if not same_way:
            self._counted_at = self._on_at
        self.state = RUN

    def _over(self):
        """The drive has come to its own end, a pulse's or a run's."""
        if not self.was_cut:
            self._cut()
        if self.homing.phase:
            self.homing.ran_out(self.state == PULSE)
        elif self.state == RUN:
            ends_as = self._ends_as
            self._finish(ends_as)
            if ends_as == codes.RUN_LIMIT:
                self.error(codes.AXIS_RUN_LIMIT)
            elif ends_as == codes.SOFT_LIMIT:
                self._soft_error(self._direction)
        else:
            self._pulse_over()

    def _pulse_over(self):
        self.bridge.off()
        self._counting = True
        on_us = self._on_us + diff(self._cut_at, self._on_at)
        self._on_us = on_us if on_us < _MOST_ON_US else _MOST_ON_US
        self.state = REST
        if self._taking_up:
            self.position.taken_up(self._direction)
            # the same rest as between two steps: a motor that still turns would make the first one longer
            self._next_at = add(self._cut_at, self._period_us - self._length_us)
            self._counting = False
            return
        if self._length_us == self.pulse_us:
            self.position.pulsed(self._direction)
        else:
            self.position.pulsed_by(self._direction, self._length_us * self._duty)
        self._steps_left -= 1
        self._counting = False
        self._next_at = add(self._on_at, self._period_us)
        self.resting = True
        if self._steps_left == 0:
            self._finish(codes.DONE)
        elif self._stopping:
            self._finish(codes.STOPPED)

    def _count(self, now_us):
        """Count what has driven up to now_us."""
        us = diff(now_us, self._counted_at)
        self._counted_at = now_us
        self._on_us += us
        self.position.driven(self._direction, us * self._duty, False)

    def _book(self):
        """The drive is over: count what was not counted yet."""
        if self.state == PULSE:  # cut short
            self._counted_at = self._on_at
            self._next_at = add(self._on_at, self._period_us)
            self.resting = True
        if self.state > REST:
            at = self._cut_at if self.was_cut else self._led_at if self._led else self._ticks_us()
            us = diff(at, self._counted_at)
            self._counted_at = at
            self._on_us += us
            self.position.driven(self._direction, us * self._duty, True)

    def _finish(self, reason):
        """Off, and the move is over."""
        self.bridge.off()
        self._close(reason)

    def _close(self, reason):
        """The move is over: book it, and remember how it ended."""
        self._counting = True
        self._book()
        self.ended_steps = self.position.made
        self.ended_on_us = self._on_us
        self.reason = reason
        self.homing.phase = 0
        self.has_moved = True
        self.state = IDLE
        self._counting = False
        if self.changed:
            self.changed = False
            self.measure()
