"""An axis with an encoder. Imports axis, codes, position, settings, ticks, and the rest of this package.

In the open loop it is an Axis. In the closed loop (`MM1`) its position is measured, its pulses last until their counts
are there, and every drive is watched. The states, the table and the drive are those of Axis: only when a pulse ends,
and what comes after it, is decided here.
"""

from mountfw import codes, const
from mountfw.encoder.closed_loop import ClosedLoop
from mountfw.encoder.position import NOISE, MeasuredPosition
from mountfw.encoder.stall_homing import StallHoming
from mountfw.encoder.watch import Watch
from mountfw.motion.axis import ASK, DUE_PULSE, END, PULSE, REST, RUN, SEARCH, SEEK, Axis
from mountfw.motion.drive import NEVER_US
from mountfw.motion.position import rounded
from mountfw.settings import ENCODER_SETTINGS, SETTINGS
from mountfw.wire.ticks import add, diff
from mountfw.wire.ticks import diff as apart  # counts wrap as times do

_MANY = const(1 << 20)  # pulses left, for the table: the closed loop counts its own
_LOOK_US = const(4_000)  # between two looks near a pulse's end, at most: the loop sleeps less than that
_LOOK_AT_RUN_US = const(13_000)  # else: the loop wakes 3 ms before, for a drive that might end then
_LOOK_AT_REST_US = const(64_000)  # an AS5600 loses count if a hand turns it by half a turn between two
_LATE_US = const(12_000)  # in a run what was received is obeyed before a look, but so long at most


class EncodedAxis(Axis):
    """reader: the encoder's (ports/encoders.py). What waits in receiver is obeyed before a look at it.

    Other arguments as of Axis. No property here: see MeasuredPosition.
    """

    entries = SETTINGS + ENCODER_SETTINGS

    # attributes, for type checkers: ENCODER_SETTINGS
    counts_per_step: int
    closed_loop: int
    dead_band: int
    correction_s: int
    following_error: int
    stall_ms: int
    stall_duty: int
    zero_angle: int

    def __init__(self, number, bridge, positive_stop, negative_stop, homing, error_queue, ticks_us, reader, receiver):
        self.reader = reader
        self.receiver = receiver
        self._looked_at = 0
        self._loop = ClosedLoop()
        self.watch = Watch()
        self.watch.play_us = reader.play_us
        self.measured = MeasuredPosition(reader, self)  # its position
        # of a shaft that nothing drives: a hand may turn it, and a sensor may fall silent
        self.still_at = 0  # counts of the motor
        self._recorded_at = 0  # the same, while they are on the flash
        self._seen_at = self._seen_band = 0  # the same, at the last look, and how far it may be off
        self._is_told = False  # was it told that the encoder does not answer?
        super().__init__(number, bridge, positive_stop, negative_stop, homing, error_queue, ticks_us, self.measured)
        self._stall_homing = StallHoming(self)

    def reset(self):
        self.unchecked = False  # is no drive watched for a stall (ZZ)?
        self._watched_at = -1  # on_at of the drive that is watched; -1: it is over
        self._bound_at = 0  # a pulse does not last longer
        self._start = None  # the place from which the move that is to begin counts its pulses, if it is by a target
        self._pulses = False  # is the move under way one of the closed loop?
        self._is_told = False
        self._limit = None  # steps: the soft limit at which the run under way ends
        super().reset()

    # ---- settings

    def load(self, values):
        for entry in ENCODER_SETTINGS:
            setattr(self, entry[1], entry[4])
        super().load(values)

    def _measure(self):
        if not self.counts_per_step:
            self.closed_loop = 0
        super()._measure()
        if not self.measured.measure(self.closed_loop, self.counts_per_step, self.inverted):
            self.watch.forget()
            self._loop.start_afresh(self.measured.place)
        per_step = self.measured.per_step
        self._loop.set_up(self.dead_band, per_step, self.pulse_us, self.step_duty, self.reader.play_us > 0)
        self._full_duty = self.step_duty  # of the next move, as all here
        self._settle_us = self.correction_s * 10_000
        self.watch.stall_us = 0 if self.unchecked else self.stall_ms * 1000
        self.watch.follow(per_step, self.pulse_us, self.following_error or per_step * 3 >> 2)

    def check_motor(self, checked):
        """Is a drive watched for a stall? From the next move on."""
        self.unchecked = not checked
        self.apply()

    def restored(self, recorded):
        """The position was restored. recorded: what its record has of the encoder; None: there is no record."""
        if not self.measured.restored(recorded):
            self.error(codes.AXIS_RECORD_DIFFERS)

    # ---- status

    def position_now(self):
        if not self.measured.closed:
            return super().position_now()
        self.measured.look()
        return self.measured.millisteps

    # ---- moves

    def move_to(self, steps):
        """Move to a position: by whole pulses from the step that is nearest now, of which the first makes up for that.

        In the open loop by the nearest whole number of pulses.
        """
        position = self.measured
        if not position.closed:
            return super().move_to(steps)
        if not self.handle(ASK, 0) or self.out_of_reach(steps, steps):
            return False
        position.look()
        nearest = rounded(position.millisteps)
        beyond = position.counts_of(position.millisteps - nearest * 1000)
        self._start = diff(position.place, beyond)  # counts wrap as times do
        self.note_relative(steps - nearest)
        self._begin_pulses(steps - nearest, self.pulse_us, steps)
        return True

    def jog(self, direction):
        begun = super().jog(direction)
        if begun:
            limited = self.state == RUN and self.measured.closed and self.checking & 8
            self._limit = (self.soft_maximum if direction > 0 else self.soft_minimum) if limited else None
        return begun

    def seek(self, direction, home):
        """Find the end-stop in direction 1 or -1, or the end by stall where none is fitted."""
        watched = self.measured.closed and self.watch.stall_us  # else the motor would be pressed on at its end
        if not (watched and self.stall_duty) or self.stop_towards(direction).fitted:
            return super().seek(direction, home)
        if not self.handle(ASK, 0):
            return False
        self.homing = self._stall_homing
        self.handle(SEEK, direction * self.stall_duty)
        self.homing.start(direction, home)
        return True

    def _begin_pulses(self, n, us, target):
        if self.measured.closed:
            n = self._begin_loop(n, us)
        super()._begin_pulses(n, us, target)
        self._pulses = self._pulses and self.state != 0

    def _begin_loop(self, n, us):
        """A closed-loop move of |n| pulses begins, each us long at XN's speed. Returns n as the loop makes it."""
        position = self.measured
        per_pulse = position.share_of_step(us, self.pulse_us)
        position.look()
        self.check_stop()
        self._pulses = True
        n = self._loop.begin(position.place, self._start, n, per_pulse)
        self._start = None
        return n

    def _next_pulse(self):
        if not self._pulses:
            super()._next_pulse()
            return
        position = self.measured
        position.look()
        self.check_stop()
        reason = self._loop.next(position.place)
        self.check_stop()
        if reason == codes.FOLLOWING:  # its counts have not come in all the time that it may take
            self._failed(reason)
        elif reason:
            self.handle(END, reason)
        else:
            self._drive(position.motor)

    def _drive(self, motor):
        """Begin the drive that the loop wants next."""
        drive, loop = self.drive, self._loop
        drive.direction = 1 if loop.way > 0 else -1
        drive.tripped = False
        self.pulses_left = _MANY
        loop.aim(drive.direction, abs(loop.way) + self.measured.gap_left(drive.direction))
        self.handle(DUE_PULSE, loop.bound_us(self.reader.play_us))
        if self.state == PULSE:
            self._bound_at = self.drive.ends_at
            self._begin_watch(motor)

    def _close(self, reason):
        if self._pulses:
            self._pulses = False
            self.measured.done()
        self._limit = None
        if self.drive.was_cut:
            self._watched_at = -1
        super()._close(reason)

    # ---- the loop

    def service(self, now_us):
        if not self.measured.closed:
            return super().service(now_us)
        if self.state > REST:
            return self._serve_drive(now_us)
        self._watched_at = -1
        if not self.state:  # what waits is obeyed first
            return NEVER_US if self.receiver.waits() else self._idle(now_us)
        if diff(now_us, self._looked_at) >= _LOOK_AT_REST_US >> 1:
            self._looked_at = now_us
            self.measured.look()
            self.check_stop()
            if self.drive.inhibited:  # a stop: it is told first
                return NEVER_US
        return self._go_on(now_us)

    def _serve_drive(self, now_us):
        """Look at the encoder, and do what is due. What comes meanwhile is obeyed first, but for so long at most."""
        drive = self.drive
        late = not 0 <= diff(now_us, self._looked_at) <= _LATE_US or self.watch.overdue(now_us)
        if not late and self.state >= RUN and self.receiver.waits():  # a correction of a pulse is over in less
            if not drive.watched and diff(drive.ends_at, now_us) > _LATE_US:
                return _LATE_US
        elif not drive.was_cut:
            reason = self._look()
            if drive.inhibited:
                return min(max(0, diff(drive.ends_at, now_us)), _LOOK_US)
            self._looked_at = now_us
            if reason:
                return self._failed(reason)
            if self._limit is not None:
                self.measured.look()
                if self.measured.reached(self._limit, drive.direction):
                    self.handle(END, codes.SOFT_LIMIT)
                    return _LOOK_AT_REST_US
        return self._go_on(now_us)

    def _go_on(self, now_us):
        before = self.state
        left_us = super().service(now_us)
        if self.state > REST:
            most_us = _LOOK_US if self._pulses and self._loop.near(self.watch.counts) else _LOOK_AT_RUN_US
            return left_us if left_us < most_us else most_us
        if before == PULSE and self.state == REST and self._pulses:
            self._rest()
            left_us = diff(self.next_at, self._ticks_us())
        return min(left_us, _LOOK_AT_REST_US)

    def _look(self):
        """Look at the encoder in a drive. Returns why it must end, or 0."""
        self.check_stop()
        drive, watch = self.drive, self.watch
        now_us = self._ticks_us()  # reading may have taken long
        motor = self.measured.motor_now()
        if drive.on_at != self._watched_at:
            if self._watched_at < 0 or drive.direction != watch.direction:
                self._begin_watch(self.measured.motor)  # before it
            else:
                self._watched_at = drive.on_at
                watch.go_on(drive.duty, drive.on_at)
        if self.reader.gone or (self.reader.slips != watch.slips and watch.lost(self.reader.slips)):
            return codes.ENCODER_LOST
        reason = watch.look(motor, now_us)
        self.check_stop()
        if not (reason or drive.duty != self._full_duty or self.checking & 2 or watch.follows(now_us)):
            return codes.FOLLOWING  # which the next look would not find again
        if self._pulses and not reason:
            self._foretell(now_us)
        return reason

    def _foretell(self, now_us):
        """When will the pulse's counts be there?"""
        us = self._loop.cut_in(self.watch)
        self.check_stop()
        if us >= 0 and not self.drive.was_cut:
            self._ends_in(us, now_us)

    def _ends_in(self, us, now_us):
        """The pulse's counts will be there then. Its bound and a soft stop are not put off by that."""
        drive = self.drive
        if diff(self._bound_at, now_us) <= us:
            self._loop.foretold = False
            us = diff(self._bound_at, now_us)
        if diff(drive.ends_at, now_us) > us or self.pulses_left != 1:
            drive.ends_at = add(now_us, us)
            if drive.gate:
                drive.gate.end_at(drive.ends_at)

    def _begin_watch(self, motor):
        self._watched_at = self.drive.on_at
        self.watch.begin(motor, self.drive, self.reader.slips)

    def _failed(self, reason):
        if self.measured.certainty:  # is it the motor that does not turn, or the encoder that does not see it?
            self.measured.certainty = codes.ESTIMATED
        self._is_told = self._is_told or self.reader.gone  # which this end tells
        if self.state == SEARCH and self.homing is self._stall_homing and reason == codes.STALLED:
            self.homing.stalled()
        else:
            self.handle(END, reason)
        return diff(self.next_at, self._ticks_us()) if self.state else _LOOK_AT_REST_US

    def _rest(self):
        """A pulse is over: the rest before the next one, or before the end is judged."""
        settled_at = add(self.drive.cut_at, self._settle_us)
        if not self._loop.left or diff(settled_at, self.next_at) > 0:
            self.next_at = settled_at

    def _idle(self, now_us):
        """Nothing moves: look at the encoder. Does nothing if its count has not changed."""
        if self.resting:
            super().service(now_us)
        position = self.measured
        band = NOISE if position.reader.play_us and self.dead_band < NOISE else self.dead_band
        seen = position.same() and position.motor == self._seen_at and band == self._seen_band
        if not (seen and not self._is_told and (self.drive.on_flash or self._recorded_at == self._seen_at)):
            self._look_at_rest(band)
        return _LOOK_AT_REST_US

    def _look_at_rest(self, band):
        position, drive = self.measured, self.drive
        self.check_stop()
        position.look()
        self.check_stop()
        motor = self._seen_at = position.motor
        self._seen_band = band
        if not drive.on_flash:
            self._recorded_at = motor
        if not -band <= apart(motor, self.still_at) <= band:  # a query may have looked before
            self.still_at = motor
            self.has_moved = True
        if drive.on_flash and not -band <= apart(motor, self._recorded_at) <= band:
            drive.drop_record()  # it would tell another number
        if position.reader.gone != self._is_told:
            self._is_told = position.reader.gone
            if self._is_told:
                self.error(codes.AXIS_ENCODER_LOST)
