"""Watches one drive by the counts it makes: stall, wrong way, following error, speed. Imports codes, ticks.

All counts here are in the drive's direction, since it began.
"""

from mountfw import codes, const
from mountfw.wire.ticks import add, diff
from mountfw.wire.ticks import diff as apart  # counts wrap as times do

_SPAN_US = const(16_384)  # the speed is that of the last one to two of these: counts come singly
_STALE_US = const(60_000)
_LEAST_US = const(4_096)  # of less the speed is not said: a shaft at rest may be a hair before its next count
FULL_SPEED_US = const(60_000)  # a drive that lasts longer ends at full speed
_ANY = const(1 << 29)
_LEAST_WRONG = const(16)  # a motor that coasts one way is driven the other way: so many at least are no error
_MOST_NOISE = const(4)  # counts of a sensor whose shaft stands still
_MOST_SLIPS = const(8)  # of one drive; more are no single disturbance


class Watch:
    """One axis's. begin() with each drive, then look() again and again."""

    def __init__(self):
        self.counts = 0
        self.stall_us = 0  # drive without a count that is a stall; 0: none is
        self.play_us = 0  # drive without a count after a change of direction: gears before the encoder
        self._went = 0  # the direction of the last counts; 0: not sure
        self._per_step = 1
        self._step_us = 1
        self._most = self._most_more = 0
        self._start = 0
        self.direction = 0
        self._duty = 0
        self._began_at = 0
        self._furthest = self._low = self._high = 0  # and the most since the lowest: it may coast back first
        self._progress_at = 0
        self.slips = 0
        self._old_at = self._new_at = 0  # two instants of the past ...
        self._old_counts = self._new_counts = 0
        self._us = self._quarters = 0  # since the older one, and quarters of a count made since, at the speed of now
        self._now = 0
        self._step_at = 0  # since then one step's time is measured ...
        self._step_counts = 0

    def follow(self, per_step, step_us, most):
        """In step_us of drive at a step's duty the counts of a step are expected, give or take `most`.

        A step that is over before the motor has come to its speed does not say how many a run may make.
        """
        self._per_step = per_step
        self._step_us = step_us
        self._most = most
        self._most_more = most if step_us > FULL_SPEED_US else _ANY

    def begin(self, motor, drive, slips):
        """This drive has begun, at these counts of the motor."""
        direction = drive.direction
        if not self._coasted(apart(motor, self._start) * self.direction - self.counts):
            self._went = 0
        self._start = motor
        self.direction = direction
        self._duty = drive.duty
        self.slips = slips
        self.counts = self._furthest = self._low = self._high = 0
        self._old_counts = self._new_counts = self._step_counts = 0
        on_at = drive.on_at
        self._began_at = self._progress_at = self._old_at = self._new_at = self._step_at = self._now = on_at
        if direction != self._went:
            self._progress_at = self._step_at = add(on_at, self.play_us * 255 // drive.duty)

    def go_on(self, duty, on_at):
        """The drive goes on, at this duty since on_at: a frame has come. What it has not made yet is still missing."""
        if duty == self._duty:
            return
        left_us = diff(self._progress_at, on_at)
        if left_us > 0:  # of the play, which lasts as long as the motor is slow
            self._progress_at = self._step_at = add(on_at, left_us * self._duty // duty)
        else:
            self._step_at = on_at
        self._step_counts = self.counts
        self._duty = duty

    def turned(self):
        """Has the motor turned in this drive? Less may be noise."""
        return self._furthest > _MOST_NOISE

    def _coasted(self, counts):
        """Can a motor have made these counts since the last look at a drive? More are a hand's."""
        return -_MOST_NOISE <= counts <= max(_LEAST_WRONG, self._per_step >> 3)

    def forget(self):
        """What was driven meanwhile was not looked at."""
        self._went = 0

    def look(self, motor, now_us):
        """The counts now. Returns the reason why the drive must end, or 0."""
        counts = self.counts = apart(motor, self._start) * self.direction
        self._now = now_us
        if counts < self._low:
            self._low = self._high = counts
        if counts > self._high:
            self._high = counts
            if diff(now_us, self._progress_at) > 0 or counts - self._low > _MOST_NOISE:  # the play is over
                self._progress_at = now_us
            if counts > self._furthest:
                self._furthest = counts
                self._went = self.direction if counts > _MOST_NOISE else 0
        else:
            back = self._furthest - counts
            if self.stall_us and diff(now_us, self._progress_at) >= self.stall_us:
                return codes.WRONG_WAY if back > _LEAST_WRONG else codes.STALLED
            if back > max(_LEAST_WRONG, self._per_step >> 3):
                return codes.WRONG_WAY
        if diff(now_us, self._new_at) >= _SPAN_US:
            if diff(now_us, self._old_at) >= _STALE_US:
                self._old_at, self._old_counts = now_us, counts
            else:
                self._old_at, self._old_counts = self._new_at, self._new_counts
            self._new_at, self._new_counts = now_us, counts
        return 0

    def overdue(self, now_us):
        """True if a look that finds no new count is to say that the motor stalled."""
        return self.stall_us > 0 and diff(now_us, self._progress_at) >= self.stall_us

    def lost(self, slips):
        """True if the encoder has slipped too often in this drive."""
        return apart(slips, self.slips) > _MOST_SLIPS

    def follows(self, now_us):
        """False if in the last step's time of drive the counts were wrong."""
        us = diff(now_us, self._step_at)
        if us < 0:  # the play may be over before the longest that it may last
            self._step_counts = self.counts
        if us < self._step_us:
            return True
        wrong = self.counts - self._step_counts - self._per_step
        self._step_at, self._step_counts = now_us, self.counts
        if us >= self._step_us * 2:  # it was not asked in time: they may be those of more than a step
            return wrong >= -self._most
        return -self._most <= wrong <= self._most_more

    def rate(self):
        """The speed, in sixteenths of a count in 16.384 ms; 0 if it is not known.

        From rest, a motor's speed after less than its time constant is nearly twice that of the mean.
        """
        us = self._us = diff(self._now, self._old_at)
        made = self.counts - self._old_counts
        quarters = self._quarters = made * 7 if self._old_at == self._began_at else made * 4
        return quarters * 65_536 // us if us >= _LEAST_US and quarters > 0 else 0

    def until(self, sixteenths):
        """Microseconds until so many sixteenths of a count (at most 8000) have come, at that speed; -1: not known."""
        if self._quarters > 0 and _LEAST_US <= self._us < _STALE_US + _SPAN_US:
            return sixteenths * self._us // (self._quarters << 2)
        return -1
