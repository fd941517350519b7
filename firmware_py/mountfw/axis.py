"""One axis: timed pulses, runs, frames and their bounds. Imports bridge, endstop, errors, ticks.

A move is started by steps(), run() or frame() and carried on by service(), which never waits.
Every accepted move ends exactly once, through _finish(), with one of the reasons of errors.py.
All driving goes through _drive(), after _may_drive() has looked at the switches and at the stops that
are about to be parsed. Times are microseconds of a clock that wraps (ticks.py); positions are millisteps.

The clock is asked right before each pin write, the one that drives and the one that cuts, so that
an on-time is what the pin had: what comes between clock and pin is the same on both sides. A drive
that must end on time is waited for with cut_on_time(); what service() finds overdue ends late.

Two things may come from an interrupt, between any two lines here: guard(), and `emergency` set.
They cut the drive and leave the rest to service(); _started() looks again after it was driven.
"""

from mountfw import errors
from mountfw.ticks import add, diff

# states of an axis, in such an order that those above REST have drive
IDLE = 0
REST = 1  # between two steps
PULSE = 2  # driving, one step
RUN = 3  # driving until told otherwise

NEVER_US = 1 << 29  # "no deadline"

MAX_STEPS = 1_000_000  # of position either way; millisteps then still fit a small integer
_FINISH_PULSE_US = 250_000  # a soft stop lets a pulse end that has less than this to go
_SHORT_US = 900  # a pulse that may be over before the loop comes round is waited for where it begins
_TURN_US = 5  # half of what one turn of that waiting takes an RP2040
_REST_US = 1_000  # least rest after a pulse
_COUNT_US = 20_000  # a run is counted at least this often while it is served, so that its sums stay small


class Axis:
    """Axis number (1 or 2) on a bridge, with its two EndStops named for the electrical direction.

    ticks_us is the clock. error_queue takes this axis's errors.
    """

    def __init__(self, number, bridge, positive_stop, negative_stop, error_queue, ticks_us):
        self.number = number
        self.bridge = bridge
        self.positive_stop = positive_stop
        self.negative_stop = negative_stop
        self._errors = error_queue
        self._ticks_us = ticks_us
        self.reset()

    def reset(self):
        """Off, and everything as at power-up."""
        self.bridge.off()

        # settings; the names stand in controller.py's table of parameters
        self.pulse_us = 200_000
        self.step_duty = 255
        self.run_duty = 255
        self.velocity = 200  # hundredths of a step per second
        self.inverted = 0
        self.run_limit_ms = 10_000
        self.move_limit_ms = 120_000
        self.checking = 0  # bit 0: end-stops ignored
        self.watched = False  # is there an end-stop to look at?
        self.fit(False, False)

        # where it is
        self.position = 0  # millisteps, whole pulses and what runs have added
        self.certainty = errors.UNKNOWN
        self.target = 0  # steps
        self.defined = 0  # steps: what the last define() said
        self.last_relative = 0  # steps

        # how the last move ended
        self.reason = errors.NONE_YET
        self.ended_steps = 0
        self.ended_on_us = 0

        # what must not be: nothing may start while one of these is set
        self.held = False  # a stop was received but not yet parsed
        self.emergency = False  # the emergency stop was hit; may be set by an interrupt

        # the move under way
        self.state = IDLE
        self.ends_at = 0  # while driving: when the drive ends by itself
        self.was_cut = False  # while driving: is it off already, since _cut_at?
        self._direction = 0
        self._duty = 0
        self._steps_left = 0
        self._steps_done = 0
        self._on_us = 0
        self._stopping = False
        self._period_us = 0
        self._timed = False  # is the end of this run its own, or the run limit?
        self._on_at = 0  # when the drive began
        self._led = False  # has lead() driven already, since _led_at?
        self._led_at = 0
        self._cut_at = 0
        self._tripped = False  # has guard() cut it?
        self._counted_at = 0  # up to when a run is counted
        self._step = 1  # what makes a step, microseconds times duty
        self._part = 0  # of a step, likewise; 0 unless it runs
        self.resting = False  # after a move's last pulse, until _next_at
        self._next_at = 0

    # ---- what it is doing

    def moving(self):
        """True from a move's acceptance to its last pulse's end."""
        return self.state != IDLE

    def driving(self):
        """True while the motor has drive."""
        return self.state > REST

    def direction(self):
        """-1, 0 or 1: where the move under way goes."""
        return self._direction if self.state else 0

    def position_now(self):
        """Millisteps, with the part of a step that a run has covered so far."""
        if self.state != RUN:
            return self.position
        self._count(self._cut_at if self.was_cut else self._ticks_us())
        return self.position + self._direction * self._part_millisteps()

    def limits(self):
        """Bit 0: positive end-stop active, bit 1: negative, bit 2: home. Switches not fitted say 0."""
        bits = (1 if self.positive_stop.active() else 0) | (2 if self.negative_stop.active() else 0)
        if self.inverted:  # the switches stay with the electrical direction; their names swap
            bits = (bits & 1) << 1 | bits >> 1
        return bits

    def fitted(self):
        """Bit 0: the positive end-stop is fitted, bit 1: the negative one."""
        return (1 if self.positive_stop.fitted else 0) | (2 if self.negative_stop.fitted else 0)

    # ---- starting

    def steps(self, n):
        """Move by n steps: n pulses, each with its rest. False if refused (an error says why)."""
        if self._refused():
            return False
        target = self.whole_steps() + n
        if not -MAX_STEPS <= target <= MAX_STEPS or abs(n) > self.move_limit_ms * 1000 // self.pulse_us:
            self.error(errors.AXIS_OUT_OF_RANGE)
            return False
        self.last_relative = n
        self.target = target
        self._steps_left = abs(n)
        self._stopping = False
        self._begin(n, self.step_duty)
        self._period_us = max(100_000_000 // self.velocity, self.pulse_us + _REST_US)
        if n == 0:
            self._finish(errors.DONE)
        elif self.resting:  # after the pulse before: this move's period counts
            self._next_at = add(self._on_at, self._period_us)
            self.state = REST
        else:
            self._pulse()
        return True

    def to(self, steps):
        """Move to a position, by the nearest whole number of pulses. False if refused."""
        if not -MAX_STEPS <= steps <= MAX_STEPS:
            self.error(errors.AXIS_OUT_OF_RANGE)
            return False
        part = self.position % 1000
        n = steps - self.position // 1000
        if part > 500 or (part == 500 and n <= 0):  # halves go away from zero
            n -= 1
        if not self.steps(n):
            return False
        self.target = steps
        return True

    def run(self, direction):
        """Run in direction 1 or -1 until stopped, at most run_limit_ms. False if refused."""
        if self._refused():
            return False
        self._begin(direction, self.run_duty)
        self._timed = False
        self._run(self.run_limit_ms, False)
        return True

    def lead(self, speed):
        """Drive at a frame's speed (not 0) now, if nothing speaks against it. frame() must follow: it does the rest.

        So both motors get a frame's speeds before the longer work of counting begins.
        """
        if not (self.held or self.emergency or self.watched):
            self._led_at = self._drive(speed)
            self._led = True

    def frame(self, speed, for_ms=0):
        """Obey a frame: drive at speed, -255 ... 255; 0 is off. Takes over from any move.

        With for_ms (at most run_limit_ms) it is done after that time; else it runs as run() does.
        """
        if speed == 0:
            self.end(errors.SUPERSEDED)
            return
        if self.emergency:
            self.end(errors.EMERGENCY_STOP)
            self.error(errors.AXIS_EMERGENCY_STOP)
            return
        same_way = False
        if self.state:
            same_way = self.state > REST and (speed > 0) == (self._direction > 0)
            self._close(errors.SUPERSEDED)  # the drive stays on, the new one may go the same way
        self._begin(speed, abs(speed))
        self._timed = 0 < for_ms <= self.run_limit_ms
        self._run(for_ms if self._timed else self.run_limit_ms, same_way)

    # ---- ending

    def end(self, reason):
        """End the move now, if there is one."""
        self._led = False
        if self.state:
            self._finish(reason)

    def stop_soon(self):
        """End the move; a pulse that is nearly over is finished first."""
        if self.state == PULSE and diff(self.ends_at, self._ticks_us()) < _FINISH_PULSE_US:
            self._stopping = True
        else:
            self.end(errors.STOPPED)

    # ---- carrying on

    def service(self, now_us):
        """Do what is due. Returns the microseconds to the next deadline, or NEVER_US."""
        if not self.state:
            if self.resting:
                self.resting = diff(self._next_at, now_us) > 0
            return NEVER_US
        if self.emergency:
            self._finish(errors.EMERGENCY_STOP)
            self.error(errors.AXIS_EMERGENCY_STOP)
            return NEVER_US
        if self.state == REST:
            left_us = diff(self._next_at, now_us)
            if left_us > 0:
                return left_us
            self._pulse()
            return diff(self.ends_at, self._ticks_us()) if self.state > REST else NEVER_US
        if self.watched and self._at_stop():
            return NEVER_US
        left_us = diff(self.ends_at, now_us)
        if left_us <= 0 or (self.was_cut and not self._tripped):  # what guard() has just cut is for the next pass
            return self._over()
        if self.state == RUN and diff(now_us, self._counted_at) >= _COUNT_US:
            self._count(now_us)
            if self.position * self._direction >= MAX_STEPS * 1000:
                self._finish(errors.RUN_LIMIT)
                self.error(errors.AXIS_OUT_OF_RANGE)
                return NEVER_US
        return left_us

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
        if self.watched and self._ahead().active():
            self._tripped = True
            self._cut()

    # ---- settings that need more than storing

    def fit(self, positive, negative):
        """Say which end-stops there are."""
        self.positive_stop.fitted = positive
        self.negative_stop.fitted = negative
        self.apply()

    def apply(self):
        """A setting was changed."""
        self.watched = not self.checking & 1 and self.fitted() != 0

    def define(self, steps):
        """Call the present position `steps`."""
        self.position = steps * 1000
        self.target = steps
        self.defined = steps
        self.certainty = errors.COUNTED

    def step_changed(self):
        """A step is no longer what was counted: a position other than 0 becomes an estimate."""
        if self.position and self.certainty:
            self.certainty = errors.ESTIMATED

    def invert(self, inverted):
        """Swap the axis's direction (0 or 1). The spot has not moved: the position changes sign."""
        if inverted != self.inverted:
            self.inverted = inverted
            self.position = -self.position
            self.target = -self.target

    def whole_steps(self):
        """The position rounded to steps, halves away from zero."""
        p = self.position_now()
        return (p + 500) // 1000 if p >= 0 else -((500 - p) // 1000)

    def error(self, number):
        """Queue error `number` of this axis."""
        self._errors.push(self.number * 100 + number)

    # ---- inside

    def _refused(self):
        if self.state:
            self.error(errors.AXIS_MOVING)
            return True
        if self.emergency:
            self.error(errors.AXIS_EMERGENCY_STOP)
        return self.emergency

    def _begin(self, direction, duty):
        """A move is accepted: from here on it must reach _finish() or _close()."""
        self._direction = 1 if direction > 0 else -1
        self._duty = duty
        self._steps_done = 0
        self._on_us = 0
        self._step = self.pulse_us * self.step_duty
        self.was_cut = False
        self._tripped = False

    def _drive(self, duty):
        """The one setter: drive at duty, -255 ... 255 but not 0, in the axis's own direction. Returns the time."""
        return self.bridge.drive(-duty if self.inverted else duty)

    def _started(self, duty):
        """Drive as _drive() does, unless lead() has done so. False, with the move ended, if it must not drive."""
        if self._led:
            self._led = False
            self._on_at = self._led_at
        elif self._may_drive():
            self._on_at = self._drive(duty)
        else:
            return False
        if self._tripped or self.held or self.emergency:  # meanwhile, by an interrupt or a look at the input
            return self._may_drive()
        return True

    def _may_drive(self):
        """False, with the move ended, if something forbids it."""
        if not (self.held or self.emergency or self.watched):
            return True
        if self.held:
            self._finish(errors.ABORTED)
        elif self.emergency:
            self._finish(errors.EMERGENCY_STOP)
            self.error(errors.AXIS_EMERGENCY_STOP)
        else:
            return not self._at_stop()
        return False

    def _ahead(self):
        """The end-stop that this move goes towards."""
        return self.positive_stop if (self._direction > 0) != (self.inverted > 0) else self.negative_stop

    def _at_stop(self):
        """True, with the move ended and its error queued, if a switch forbids this direction."""
        positive = self.positive_stop
        negative = self.negative_stop
        if not self.watched:
            return False
        ahead = self._ahead()
        if not (self._tripped or ahead.active()):
            return False
        behind = negative if ahead is positive else positive
        both = behind.active()
        self._finish(errors.FAULT if both else errors.END_STOP)
        if both:
            self.error(errors.AXIS_BOTH_STOPS)
        else:
            self.error(errors.AXIS_POSITIVE_STOP if self._direction > 0 else errors.AXIS_NEGATIVE_STOP)
        return True

    def _cut(self):
        self._cut_at = self._ticks_us()
        self.bridge.cut()
        self.was_cut = True

    def _pulse(self):
        self.resting = False
        self.was_cut = False
        if self._started(self._duty * self._direction):
            self.ends_at = add(self._on_at, self.pulse_us)
            self.state = PULSE
            if self.pulse_us < _SHORT_US:
                self.cut_on_time()

    def _run(self, limit_ms, same_way):
        self.resting = False
        if self._started(self._duty * self._direction):
            self.ends_at = add(self._on_at, limit_ms * 1000)
            if not same_way:
                self._counted_at = self._on_at
            self.state = RUN

    def _over(self):
        """The drive has come to its own end, a pulse's or a run's. Returns as service() does."""
        if not self.was_cut:
            self._cut()
        if self.state == RUN:
            timed = self._timed
            self._finish(errors.DONE if timed else errors.RUN_LIMIT)
            if not timed:
                self.error(errors.AXIS_RUN_LIMIT)
            return NEVER_US
        self.bridge.off()
        self._on_us += diff(self._cut_at, self._on_at)
        self._steps_done += 1
        self._steps_left -= 1
        self.position += self._direction * 1000
        self._next_at = add(self._on_at, self._period_us)
        self.resting = True
        self.state = REST
        if self._steps_left == 0:
            self._finish(errors.DONE)
        elif self._stopping:
            self._finish(errors.STOPPED)
        else:
            return diff(self._next_at, self._ticks_us())
        return NEVER_US

    def _count(self, now_us):
        """Add what a run has driven up to now_us, as steps: on-time / pulse_us x duty / step_duty."""
        d = diff(now_us, self._counted_at)
        self._counted_at = now_us
        self._on_us += d
        part = self._part + d * self._duty
        if part >= self._step:
            whole = part // self._step
            part -= whole * self._step
            self._steps_done += whole
            self.position += self._direction * whole * 1000
        self._part = part
        if self.certainty:  # unless it is unknown anyway
            self.certainty = errors.ESTIMATED

    def _part_millisteps(self):
        if self._step < 1_000_000:
            return (self._part * 1000 + self._step // 2) // self._step
        step = self._step // 1000
        return (self._part + step // 2) // step  # the product would not fit a small integer

    def _finish(self, reason):
        """Off, and the move is over."""
        self.bridge.off()
        self._close(reason)

    def _close(self, reason):
        """The move is over: count what was not counted, and remember how it ended."""
        if self.state == PULSE:  # cut short
            self._counted_at = self._on_at
            self._next_at = add(self._on_at, self._period_us)
            self.resting = True
        if self.state > REST:
            self._count(self._cut_at if self.was_cut else self._led_at if self._led else self._ticks_us())
            if self._part:
                self.position += self._direction * self._part_millisteps()
                self._part = 0
        self.reason = reason
        self.ended_steps = self._direction * self._steps_done
        self.ended_on_us = self._on_us
        self.state = IDLE
