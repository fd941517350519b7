"""One axis: the table of its states and events, and the moves.

A move is asked for by steps(), one_pulse(), move_to(), jog(), seek() or frame(), and carried on by service(), which
never waits. Each of these, each stop, each deadline and each switch is an event. TABLE, at the end of this file, has
for every event in every state the next state and the action; handle() does what it says, and nothing else changes the
state.

An action takes the value of its event. It returns True if the table's next state is right; False if the state stays,
or another event was handled meanwhile.
"""

from mountfw import codes, const
from mountfw.motion.drive import NEVER_US, Drive
from mountfw.motion.position import EDGE, Position, rounded
from mountfw.settings import MAX_STEPS, Settings
from mountfw.wire.ticks import add, diff

# states: those above REST have drive; from RUN on it is counted as time goes by
IDLE = const(0)  # no move
SETTLE = const(1)  # homing, at rest
REST = const(2)  # a move is accepted, or between two of its pulses
TAKE_UP = const(3)  # a pulse through the backlash
PULSE = const(4)
RUN = const(5)  # a run or a frame
SEARCH = const(6)  # a leg of homing

# events, and the value that goes with each
ASK = const(0)  # a move is asked for, and not by a frame
BEGIN = const(1)  # it is accepted (signed speed)
SEEK = const(2)  # homing is accepted (signed speed)
FRAME = const(3)  # a frame drives (signed speed)
FINISH = const(4)  # a soft stop, and little of the drive is left (reason)
END = const(5)  # all else that ends a move: stops, faults, homing has found it (reason)
DUE_TAKE_UP = const(6)  # the take-up pulse is due (for so many microseconds at most)
DUE_PULSE = const(7)
DUE_RUN = const(8)
DUE_SEARCH = const(9)
DUE_SETTLE = const(10)  # homing is to rest (microseconds)
OVER = const(11)  # the drive has come to its deadline
LAST_OVER = const(12)  # so has the last pulse
HIT = const(13)  # the end-stop ahead is open (reason)

_SHORT_US = const(1_500)  # a drive that may be over before the loop comes round is waited for where it begins
_COUNT_US = const(1_000_000)  # a run is counted at least this often, so that its sums stay small, ...
_COUNT_STEPS = const(100)  # ... and within so many steps at duty 1: it ends before its position is too large
_FINISH_US = const(250_000)  # a soft stop lets a pulse end that has less than this to go
_SHORTEST_US = const(200)  # no pulse is shorter, so less than that is not taken up


class Axis(Settings):
    """Axis number (1, 2 ...) on a bridge, with its two EndStops named for the electrical direction.

    homing is None, or makes what finds them (a Homing). ticks_us is the clock. error_queue takes this axis's errors.
    Its settings are its attributes.
    """

    def __init__(self, number, bridge, positive_stop, negative_stop, homing, error_queue, ticks_us, position=None):
        self.number = number
        self.positive_stop = positive_stop
        self.negative_stop = negative_stop
        self._errors = error_queue
        self._ticks_us = ticks_us
        self.position = position or Position()
        self.drive = Drive(bridge, [negative_stop, positive_stop, negative_stop], ticks_us)  # [0] stands for none
        self._tuned = 0  # the bridge's PWM frequency and decay, in one number; 0: as made
        self.switch_homing = self.homing = homing and homing(self)  # the homing of this axis, and the one under way
        self.has_moved = False  # has a move ended, or was its position defined, since store.py asked last?
        self.check_stop = bool  # nothing: the App sets its own, by which a stop in the middle of longer work cuts
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
        tuned = self.pwm_hz << 1 | self.slow_decay
        if tuned != self._tuned:  # at rest: they cannot be set in a move
            self._tuned = tuned
            bridge = self.drive.bridge
            bridge.tune(self.pwm_hz or bridge.made_hz, self.slow_decay)
        self.changed = self.state != 0  # then _close() measures
        if not self.changed:
            self._measure()

    def _measure(self):
        """Compute the amounts of drive that make a step, and the gap. A change counts from the next move."""
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

    def handle(self, event, value):
        """Do the action of TABLE for this event. True if it was done, and the state is the next one."""
        self.check_stop()  # actions take long
        cell = TABLE[event][self.state]
        if cell[1](self, value):
            self.state = cell[0]
            return True
        return False

    # ---- status

    def moving(self):
        """True from a move's acceptance to its last pulse's end."""
        return self.state != IDLE

    def direction(self):
        """-1, 0 or 1: direction of the move under way."""
        return self.drive.direction if self.state else 0

    def position_now(self):
        """Millisteps, with the part of a step that a run has covered so far."""
        if self.state < RUN:
            return self.position.millisteps
        self.count(False)
        return self.position.now(self.drive.direction)

    # ---- moves; False: refused, and an error says why

    def steps(self, n):
        """Move by n steps: n pulses, each with its rest."""
        if not -MAX_STEPS <= n <= MAX_STEPS:
            self.error(codes.AXIS_OUT_OF_RANGE)
            return False
        return self._steps(n)

    def _steps(self, n):
        if not self.handle(ASK, 0):
            return False
        target = rounded(self.position_now()) + n
        if self.out_of_reach(target, target):
            return False
        self.note_relative(n)
        self._begin_pulses(n, self.pulse_us, target)
        return True

    def note_relative(self, n):
        """A move by n steps, for PR?. move_to() may go further than an answer can say (wire/replies.py)."""
        self.last_relative = max(-MAX_STEPS, min(MAX_STEPS, n))

    def one_pulse(self, us):
        """Move by one pulse of its own length: 200 ... 2 000 000 us, either way."""
        if not self.handle(ASK, 0):
            return False
        way = 1 if us > 0 else -1
        target = self.position.millisteps + way * self.position.worth(abs(us) * self.step_duty)
        if self.out_of_reach(target // 1000, -(-target // 1000)):
            return False
        self._begin_pulses(way, abs(us), rounded(target))
        return True

    def move_to(self, steps):
        """Move to a position, by the nearest whole number of pulses."""
        if not -MAX_STEPS <= steps <= MAX_STEPS:
            self.error(codes.AXIS_OUT_OF_RANGE)
            return False
        part = self.position.millisteps % 1000
        n = steps - self.position.millisteps // 1000
        if part > 500 or (part == 500 and n <= 0):  # halves go away from zero
            n -= 1
        if not self._steps(n):
            return False
        self.position.target = steps
        return True

    def jog(self, direction):
        """Run in direction 1 or -1 until stopped, at most run_limit_ms and to the soft limit."""
        if not self.handle(ASK, 0):
            return False
        most_us = self.run_limit_ms * 1000
        ends_as = codes.RUN_LIMIT
        if self.checking & 8:
            limit = self.soft_maximum if direction > 0 else self.soft_minimum
            left_us = self.position.drive_to(limit, direction, self.run_duty)
            if left_us <= 0:
                self.error_of(codes.SOFT_LIMIT, direction)
                return False
            if left_us < most_us:
                most_us = left_us
                ends_as = codes.SOFT_LIMIT
        self.handle(BEGIN, direction * self.run_duty)
        self.ends_as = ends_as
        self.handle(DUE_RUN, most_us)
        return True

    def seek(self, direction, home):
        """Find the end-stop in direction 1 or -1; with home, position 0 is there."""
        if not self.handle(ASK, 0):
            return False
        if not (self.drive.watched and self.stop_towards(direction).fitted):
            self.error(codes.AXIS_NOT_FITTED)
            return False
        self.homing = self.switch_homing
        self.handle(SEEK, direction * self.run_duty)
        self.homing.start(direction, home)
        return True

    def frame(self, speed, for_ms=0):
        """Drive at speed, -255 ... 255; 0 is off. It supersedes any move. drive.begin() may have come before.

        With for_ms (at most run_limit_ms) it is done after that time; else it runs as jog() does.
        """
        if speed == 0:
            self.abort(codes.SUPERSEDED)
            return True
        drive = self.drive
        if drive.emergency:
            if not self.state:
                self.error(codes.AXIS_EMERGENCY_STOP)
            self.abort(codes.EMERGENCY_STOP)
            if drive.has_begun:  # it has opened since
                drive.has_begun = False
                drive.release()
                self.position.driven(1 if speed > 0 else -1, abs(speed) * diff(self._ticks_us(), drive.began_at), True)
            return False
        self.handle(FRAME, speed)
        self.ends_as = codes.DONE if for_ms else codes.RUN_LIMIT
        self.handle(DUE_RUN, (for_ms or self.run_limit_ms) * 1000)
        return True

    def _begin_pulses(self, n, us, target):
        """Begin a move to target (steps) by |n| pulses of us each.

        The first pulse waits until the period of the last move's last pulse is over, but not longer than a period: at
        the prompt that pulse may be so long ago that the clock has wrapped.
        """
        self.position.target = target
        self.pulses_left = abs(n)
        self.ends_as = codes.DONE
        self.handle(BEGIN, self.step_duty if n > 0 else -self.step_duty)
        if n == 0:
            self.handle(END, codes.DONE)
            return
        rest_us = 100_000_000 // self.possible_velocity() - self.pulse_us
        before_us = self.length_us + rest_us
        self.length_us = us
        self.period_us = us + rest_us
        self.next_at = add(self.drive.on_at, before_us)
        if not (self.resting and 0 < diff(self.next_at, self._ticks_us()) <= before_us):
            self._next_pulse()

    def _next_pulse(self):
        """Give the next pulse of a move by steps: first one for the backlash, if there is any to take up."""
        us = self.position.take_up(self.drive.direction) // self.drive.duty
        if us >= _SHORTEST_US:
            self.handle(DUE_TAKE_UP, us)
        else:
            self.handle(DUE_PULSE, self.length_us)

    # ---- stops

    def abort(self, reason):
        """End the move now, if there is one."""
        if self.counting:  # Ctrl-C, or a fault, came in the middle of that
            self.counting = False
            self.position.certainty = codes.UNKNOWN
        if self.state:
            self.handle(END, reason)

    def stop_soon(self):
        """End the move; a pulse that is nearly over is finished first."""
        if diff(self.drive.ends_at, self._ticks_us()) < _FINISH_US:
            self.handle(FINISH, codes.STOPPED)
        else:
            self.abort(codes.STOPPED)

    def forbidden(self, reason):
        """Drive.on(), or a switch, forbids the drive for this reason: the move ends."""
        if not self.drive.was_cut:
            self.drive.cut()
        if reason != codes.END_STOP:
            self.handle(END, reason)
        elif self.stop_towards(-self.drive.direction).active():
            self.handle(END, codes.FAULT)
            self.error(codes.AXIS_BOTH_STOPS)
        else:
            self.handle(HIT, codes.END_STOP)

    # ---- the loop

    def service(self, now_us):
        """Do what is due. Returns the microseconds to the next deadline, or NEVER_US."""
        state = self.state
        if not state:
            if self.resting:
                self.resting = diff(self.next_at, now_us) > 0
            return NEVER_US
        drive = self.drive
        if drive.emergency:
            self.handle(END, codes.EMERGENCY_STOP)
        elif state <= REST:
            left_us = diff(self.next_at, now_us)
            if left_us > 0:
                return left_us
            if state == SETTLE:
                self.homing.rested()
            else:
                self._next_pulse()
        elif drive.watched and drive.at_stop():
            self.forbidden(codes.END_STOP)
        elif state != SEARCH or not self.homing.watch():
            left_us = 0 if drive.was_cut and not drive.tripped else diff(drive.ends_at, now_us)
            if left_us <= 0:  # if guard() has just cut this drive, the next pass ends the move
                if not drive.was_cut:
                    drive.cut()
                self.handle(LAST_OVER if state == PULSE and self.pulses_left == 1 else OVER, 0)
            else:
                if state < RUN:
                    return left_us
                if diff(now_us, drive.counted_at) >= self.count_us:
                    self.count(False)
                if self.position.millisteps * drive.direction < EDGE:
                    return left_us if left_us < self.count_us else self.count_us
                self.handle(END, codes.RUN_LIMIT)
        if not self.state:
            return NEVER_US
        return diff(self.next_at if self.state <= REST else drive.ends_at, self._ticks_us())

    # ==== the actions of the table

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
        """Drive for us at most. If Drive.on() refuses, the move ends."""
        self.resting = False
        drive = self.drive
        reason = drive.on(us)
        if reason:
            self.forbidden(reason)
        elif us < _SHORT_US:
            drive.end_on_time(self.check_stop, 1)
        return not reason

    # ---- a drive is over

    def taken_up(self, _value):
        """Count a whole take-up. The rest after it is that between two steps: a motor still turning adds to a step."""
        self.counting = True
        drive = self.drive
        drive.release()
        drive.measured_us(True)
        self.position.taken_up(drive.direction)
        self.next_at = add(drive.cut_at, self.period_us - self.length_us)
        self.counting = False
        return True

    def pulsed(self, _value):
        """Count a whole pulse: one step, or by its time if one_pulse() gave it a length."""
        self.counting = True
        drive = self.drive
        drive.release()
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
        self.drive.release()
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
        self.drive.release()
        self.keep_period()
        return self.finish(reason)

    def finish(self, reason):
        """Off, and the move is over."""
        self.drive.release()
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


# cells: the next state and the action; where the action returns False, the state stays
_ = (IDLE, Axis.cannot_happen)
nothing = (IDLE, lambda axis, reason: False)  # there is no move to end
allow = (IDLE, Axis.may_begin)
refuse = (IDLE, Axis.refuse)
begin = (REST, Axis.begin)
seek = (SETTLE, Axis.begin)
replace = (REST, Axis.supersede)
take_up = (TAKE_UP, Axis.turn_on)
pulse = (PULSE, Axis.turn_on)
run = (RUN, Axis.turn_on)
search = (SEARCH, Axis.turn_on)
settle = (SETTLE, Axis.settle)
rest = (REST, Axis.taken_up)
count = (REST, Axis.pulsed)
done = (IDLE, Axis.last_pulsed)
limit = (IDLE, lambda axis, _: axis.finish(axis.ends_as))
last = (PULSE, Axis.make_last)
cut = (IDLE, Axis.cut_short)
end = (IDLE, Axis.finish)
h_over = (IDLE, lambda axis, _: axis.homing.over())  # these two ask homing, which makes an event of its own
h_hit = (IDLE, lambda axis, _: axis.homing.hit())

# fmt: off
TABLE = {
    # event       IDLE     SETTLE   REST     TAKE_UP  PULSE    RUN      SEARCH
    ASK:         (allow,   refuse,  refuse,  refuse,  refuse,  refuse,  refuse),
    BEGIN:       (begin,   _,       _,       _,       _,       _,       _),
    SEEK:        (seek,    _,       _,       _,       _,       _,       _),
    FRAME:       (begin,   replace, replace, replace, replace, replace, replace),
    FINISH:      (nothing, end,     end,     cut,     last,    end,     end),
    END:         (nothing, end,     end,     cut,     cut,     end,     end),
    DUE_TAKE_UP: (_,       _,       take_up, _,       _,       _,       _),
    DUE_PULSE:   (_,       _,       pulse,   _,       _,       _,       _),
    DUE_RUN:     (_,       _,       run,     _,       _,       _,       _),
    DUE_SEARCH:  (_,       search,  _,       _,       _,       _,       _),
    DUE_SETTLE:  (_,       settle,  _,       _,       _,       _,       settle),
    OVER:        (_,       _,       _,       rest,    count,   limit,   h_over),
    LAST_OVER:   (_,       _,       _,       _,       done,    _,       _),
    HIT:         (_,       h_hit,   end,     cut,     cut,     end,     h_hit),
}
# fmt: on
