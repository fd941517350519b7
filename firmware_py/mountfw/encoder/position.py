"""Where an axis is, by the counts of its encoder. Imports codes, position, ticks.

In the open loop it is a Position as of any axis. In the closed loop the amounts that others hand in, which are time
times duty, count for nothing: each call looks at the encoder instead. What the encoder has turned goes through the gap
first, as a drive's amount does, but in counts.
"""

from mountfw import codes, const
from mountfw.motion.position import MOST_US, Position, rounded
from mountfw.wire.ticks import diff as apart  # counts wrap as times do

_SMALL = const(1 << 29)
_TURN = const(4096)
NOISE = const(4)  # counts that a shaft at rest may be off: of the sensor, and what the screw gives
_MOST_GAP = const(20_000)  # thousandths of a step


class MeasuredPosition(Position):
    """The position of an axis whose encoder is read by reader (ports/encoders.py). It sets the axis's zero_angle.

    It is looked at in each pass, so it has no property: where a class has one, MicroPython searches the class, and
    those that it is made of, at each `self.name =` (py/objtype.c), which doubled the time of a look.
    """

    def __init__(self, reader, axis):
        self.reader = reader
        self._axis = axis
        self.per_step = 1  # counts
        self._counts_per_step = 0  # the same, signed; 0: not known
        self._step_differs = False  # has the open loop's step changed since this one was measured in?
        self.way = 1  # of the encoder, in the axis's own direction
        self.raw = 0  # the reader's counts when it was looked at
        self.motor = 0  # the same in the axis's direction; wraps
        self.place = 0  # what of it has moved the mirror; wraps
        self._slips = 0
        self._blind = False  # did it not answer at `raw`? Then its first answer is no motion
        self._torn = False  # is a look not over, or left by a Ctrl-C?
        self._gap_counts = 0
        self._at = 0  # counts from the gap's negative end, as `inside` ...
        self._inside_shown = 0  # ... which was made of them
        self._base = 0  # millisteps, plus steps and counts since
        self._steps = 0
        self._counts = 0
        self._shown = 0  # millisteps, as they were made of these
        self._begun = 0  # the place where the move under way began
        super().__init__()

    def reset(self):
        """As at power-up: nothing is known."""
        super().reset()
        self._count_from_here()

    def measure(self, closed, counts_per_step, inverted):
        """The settings are these. XP, XD and XB are in step and gap already.

        True in a closed loop whose encoder counts the same way as before: then the last drive says where the play is.
        """
        before = self.way
        closed = bool(closed and counts_per_step)
        if closed != self.closed or (closed and counts_per_step != self._counts_per_step):
            if self.closed:
                self._open(closed)
            self.lose_gap()
            self.closed = closed
            self._count_from_here()
            self._rebase()
        self._counts_per_step = counts_per_step
        if counts_per_step:
            self.per_step = abs(counts_per_step)
        self.way = -1 if (counts_per_step < 0) != (inverted > 0) else 1
        self._measure_gap()
        return closed and self.way == before

    def _count_from_here(self):
        self.raw = self.reader.counts()
        self._slips = self.reader.slips
        self._blind = self.reader.gone

    def _open(self, again):
        """The closed loop ends. again: another one begins, in which a step is another, or counts the other way."""
        self.look()
        if again or self._step_differs:
            super().step_changed()
        self._step_differs = False
        if not -NOISE <= apart(self.motor, self._axis.still_at) <= NOISE:  # it may be coasting
            self._beside()
        elif self.certainty:
            self._on_a_step()

    def _beside(self):
        if self.certainty:
            self.certainty = codes.ESTIMATED

    def _on_a_step(self):
        """It is counted from here on, if it is a step's."""
        beside = abs(self.counts_of(self.millisteps - rounded(self.millisteps) * 1000))
        if beside > max(NOISE, min(self._axis.dead_band, self.per_step >> 4)):
            self._beside()
        elif self.certainty == codes.MEASURED:
            self.certainty = codes.COUNTED

    def _measure_gap(self):
        thousandths = min(self.gap // max(1, self.step // 1000), _MOST_GAP)  # of a step, so that no product is large
        gap_counts = thousandths * self.per_step // 1000
        if gap_counts != self._gap_counts:
            self._gap_counts = gap_counts
            self.lose_gap()

    def _rebase(self):
        """Others have said where it is: count from there."""
        self._base = self._shown = self.millisteps
        self._steps = self._counts = 0
        if self._gap_counts:
            self._at = min(self.inside // max(1, self.gap // self._gap_counts), self._gap_counts)
        self._inside_shown = self.inside

    # ---- what the encoder says

    def look(self):
        """Count what it has turned since. Returns the counts in the axis's own direction."""
        raw = self.reader.counts()
        self._axis.check_stop()
        if self.reader.slips != self._slips or self.reader.gone:
            self._doubt(raw)
        turned = apart(raw, self.raw) * self.way
        if not turned:
            return 0
        if self.millisteps != self._shown or self.inside != self._inside_shown:
            self._rebase()
        moved = self._through(turned) if self._gap_counts else turned
        counts = self._counts + moved
        whole = counts // self.per_step
        counts -= whole * self.per_step
        shown = self._base + (self._steps + whole) * 1000 + (counts * 1000 + (self.per_step >> 1)) // self.per_step
        self.raw = raw  # from here on no jump, which is where a Ctrl-C may come: all of it is counted, or nothing
        self.motor = apart(self.motor + turned, 0)
        self.place = apart(self.place + moved, 0)
        self._steps += whole
        self._counts = counts
        self.millisteps = self._shown = shown
        self._torn = False
        return turned

    def _doubt(self, raw):
        """Counts are missing, or the sensor does not answer."""
        if self._blind and not self.reader.gone:
            self.raw = raw
            self._blind = False
        self._beside()
        self._slips = self.reader.slips  # last: a Ctrl-C before that leaves the doubt to the next look

    def motor_now(self):
        """The motor's counts, in the axis's own direction. Without a gap they are not counted yet: look() does that."""
        if self._gap_counts:  # where the motor turns back matters
            self.look()
            return self.motor
        return self.motor + apart(self.reader.counts(), self.raw) * self.way

    def same(self):
        """True if there is nothing for look() to count or to tell."""
        return self.reader.counts() == self.raw and self.reader.slips == self._slips and not self.reader.gone

    def _through(self, turned):
        """What of these counts has moved the mirror."""
        if self._torn:  # the gap has these counts already, or a part of them
            self._beside()
            self.lose_gap()
        self._torn = True
        direction = 1 if turned > 0 else -1
        if not self.gap_known:
            if direction != self._way:
                self._way = direction
                self._one_way = 0
            self._one_way += abs(turned)
            if self._one_way >= self._gap_counts:
                self.gap_known = True
                self._to(self._gap_counts if direction > 0 else 0)
            return turned
        at = self._at + turned
        moved = at - self._gap_counts if at > self._gap_counts else at if at < 0 else 0
        self._to(at - moved)
        return moved

    def _to(self, at):
        self._at = at
        self.inside = self._inside_shown = self.gap if at == self._gap_counts else self.gap // self._gap_counts * at

    def gap_left(self, direction):
        """Counts that the motor turns in this direction before the mirror moves, as far as is known."""
        if not (self._gap_counts and self.gap_known):
            return 0
        return self._gap_counts - self._at if direction > 0 else self._at

    def in_counts(self):
        """The position in counts, rounded."""
        if self.millisteps != self._shown:
            self._rebase()
        return self.counts_of(self._base) + self._steps * self.per_step + self._counts

    def share_of_step(self, us, step_us):
        """Counts of a pulse of us at the speed of a step, so that the product is a small integer."""
        if step_us > 100_000:
            us >>= 5
            step_us >>= 5
        return us // step_us * self.per_step + us % step_us * self.per_step // step_us

    def counts_of(self, millisteps):
        """Millisteps in counts, rounded; bounded, so that they are a small integer."""
        steps = millisteps // 1000
        most = _SMALL // self.per_step
        if not -most < steps < most:
            return _SMALL if steps > 0 else -_SMALL
        return steps * self.per_step + (millisteps % 1000 * self.per_step + 500) // 1000

    def done(self):
        """A drive is over: whole steps since the move began. What is still to coast is no missing step."""
        self.look()
        self._axis.check_stop()
        way = apart(self.place, self._begun)
        self.made = (abs(way) + (self.per_step >> 4)) // self.per_step * (1 if way > 0 else -1)

    def reached(self, steps, direction):
        """True if this position (steps) is no longer ahead in a direction."""
        ahead = direction * (steps - self.millisteps // 1000)
        return ahead < 0 or (ahead == 0 and (direction > 0 or not self.millisteps % 1000))

    # ---- the angle within a turn, of a sensor that knows it

    def angle(self):
        """0 … 4095; -1: the encoder does not know it, or does not answer."""
        return self.reader.angle() if hasattr(self.reader, "angle") else -1

    def _zero(self):
        """The position was defined: note the angle that belongs to 0."""
        angle = self.angle()
        if angle >= 0:
            self._axis.zero_angle = (angle - self.way * self.in_counts()) % _TURN or _TURN

    def recorded(self):
        """Of a record: the angle; counts of the step that it is measured in, or 0; is the timed step another since?"""
        return self.angle(), self._counts_per_step if self.closed else 0, self._step_differs

    def restored(self, recorded):
        """It was restored with this of recorded(): less by an older firmware, None without a record.

        False if it is not there any more.
        """
        self._rebase()
        measured_in, differs = recorded[1:3] if len(recorded or ()) > 2 else (0, 0)
        in_other_steps = measured_in not in (0, self._counts_per_step)
        if not self.closed:
            if differs or in_other_steps:
                super().step_changed()
            self._on_a_step()
            return True
        if in_other_steps:
            self.reset()
            return True
        self._step_differs = differs != 0
        angle = self.angle()
        since = self._axis.zero_angle if recorded is None else (recorded or (-1,))[0]  # the former: 0: not known
        if self.reader.gone or angle >= 0 > since:
            self._beside()
        if angle < 0 or since < 0 or (recorded is None and not since):
            return True
        turned = (angle - since + (_TURN >> 1)) % _TURN - (_TURN >> 1)
        if recorded is None:
            self.millisteps = 0
        elif -NOISE <= turned <= NOISE:
            return True
        if self.certainty or recorded is None:
            self.certainty = codes.ESTIMATED
        self.millisteps += turned * self.way * 1000 // self.per_step
        self.target = rounded(self.millisteps)
        self._rebase()
        return recorded is None

    # ---- as of a Position

    def begin(self):
        super().begin()
        self._begun = self.place

    def pulsed(self, direction):
        if self.closed:
            self.look()
        else:
            super().pulsed(direction)

    def driven(self, direction, amount, over):
        if not self.closed:
            super().driven(direction, amount, over)
            return
        if over:
            self.done()
        else:
            self.look()

    def drive_to(self, steps, direction, duty):
        if not self.closed:
            return super().drive_to(steps, direction, duty)
        self.look()
        return 0 if self.reached(steps, direction) else MOST_US  # the axis looks whether it is there

    def now(self, direction):
        return self.millisteps if self.closed else super().now(direction)

    def lose_gap(self):
        super().lose_gap()
        self._at = self._inside_shown = 0

    def step_changed(self):
        if self.closed:
            self._step_differs = True
        else:
            super().step_changed()

    def mirror(self):
        if self.closed:
            self.look()
        super().mirror()
        self._rebase()

    def define(self, steps):
        if self.closed:
            self.look()
        super().define(steps)
        self._rebase()
        if self.closed:
            self._step_differs = False
            self._measured()
            self._zero()

    def homed(self):
        super().homed()
        if self.closed:
            self._measured()

    def _measured(self):
        """It is known where this is, and the encoder counts from here on, if it answers."""
        self.certainty = codes.ESTIMATED if self.reader.gone else codes.MEASURED
