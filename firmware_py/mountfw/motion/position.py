"""Where an axis is: its position, and what that is worth. Imports codes, settings.

A drive is counted as microseconds times duty. `step` of it, one pulse's, is a step.

A drive that has changed direction first turns through the backlash, `gap` of it, while the mirror stands still: that
much is no part of a step. `inside` is how far the drive is from the gap's negative end, 0 ... gap. An axis without
take-up (setting `take_up_us`) has no gap.
"""

from mountfw import codes, const
from mountfw.settings import MAX_STEPS

EDGE = MAX_STEPS * 1000  # millisteps: of what can be counted, either way
MOST_US = const(400_000_000)  # nothing drives longer: the greatest run limit


def rounded(millisteps):
    """In steps, halves away from zero."""
    return (millisteps + 500) // 1000 if millisteps >= 0 else -((500 - millisteps) // 1000)


class Position:
    """Position of one axis in millisteps, and target in steps. If it is `closed` an encoder measures it."""

    def __init__(self):
        self.closed = False
        self.step = 1  # what makes a step
        self.gap = 0  # 0: it has none
        self.reset()

    def reset(self):
        """As at power-up: nothing is known."""
        self.millisteps = 0  # whole pulses and what runs have added
        self.certainty = codes.UNKNOWN
        self.target = 0
        self.defined = 0  # steps: what the last define() said
        self.home_known = False  # was it homed, and every step since counted?
        self.home = 0  # millisteps: where home is then
        self.offset_known = False  # when it was homed last: was it known where home was,
        self.offset = 0  # and how far off (millisteps) was the count?
        self.part = 0  # of a step that a run is in the middle of
        self.begin()
        self.lose_gap()

    # ---- what has driven

    def begin(self):
        """A move begins."""
        self.made = 0  # whole steps of it, signed

    def pulsed(self, direction):
        """A whole pulse has moved the mirror."""
        self.millisteps += direction * 1000
        self.made += direction
        if self.gap:
            self.through_gap(direction, self.step)

    def worth(self, amount):
        """Millisteps that an amount of drive is worth."""
        return amount // self.step * 1000 + self._thousandths(amount % self.step)

    def driven(self, direction, amount, over):
        """A run, or a part of a pulse, has driven by amount. If it is over, the part of a step becomes millisteps."""
        if self.gap:
            amount = self.through_gap(direction, amount)
        if self.certainty and amount:  # unless it is unknown anyway
            self.certainty = codes.ESTIMATED
        part = self.part + amount
        if part >= self.step:
            whole = part // self.step
            part -= whole * self.step
            self.millisteps += direction * whole * 1000
            self.made += direction * whole
        self.part = part
        if over and part:
            self.millisteps = self.now(direction)
            self.part = 0

    def now(self, direction):
        """Millisteps, with the part of a step so far."""
        return self.millisteps + direction * self._thousandths(self.part)

    def _thousandths(self, part):
        """A part of a step in thousandths."""
        if self.step < 1_000_000:
            return (part * 1000 + self.step // 2) // self.step
        step = self.step // 1000
        return (part + step // 2) // step  # the product would not fit a small integer

    def drive_to(self, steps, direction, duty):
        """How long to drive in direction at duty to come to a position; 0 if it lies behind, at most MOST_US."""
        steps = direction * (steps - self.millisteps // 1000)
        thousandths = direction * -(self.millisteps % 1000)  # and so many of one more
        us = self.step // duty  # of a step
        if steps < 0 or (steps == 0 and thousandths <= 0):
            return 0
        if us and steps > MOST_US // us:
            return MOST_US
        part = thousandths * us // 1000 if us < 1_000_000 else us // 1000 * thousandths  # no product is too large
        us = part + steps * us + steps * (self.step % duty) // duty
        if us > 0:
            us += self.take_up(direction) // duty
        return min(us, MOST_US)

    # ---- what is said of it

    def define(self, steps):
        """Call the present position `steps`."""
        home = self.home // 1000 + steps - self.millisteps // 1000
        if -MAX_STEPS <= home < MAX_STEPS:
            self.home = home * 1000 + self.home % 1000 - self.millisteps % 1000
        else:
            self.home_known = False
        self.millisteps = steps * 1000
        self.target = self.defined = steps
        self.certainty = codes.COUNTED

    def homed(self):
        """This is home, position 0."""
        self.offset_known = self.home_known and abs(self.millisteps // 1000 - self.home // 1000) < MAX_STEPS
        self.offset = self.millisteps - self.home if self.offset_known else 0
        self.define(0)
        self.home = 0
        self.home_known = True
        self.certainty = codes.HOMED

    def scale(self, step, gap):
        """What makes a step, and the size of the gap. A new size says that the old one was wrong: it is found again."""
        if step != self.step:
            self.step_changed()
            self.step = step
        if gap != self.gap:
            self.gap = gap
            self.lose_gap()

    def step_changed(self):
        """A step is no longer what was counted: a position other than 0 becomes an estimate."""
        if self.millisteps and self.certainty:
            self.certainty = codes.ESTIMATED
        self.home_known = False

    def mirror(self):
        """The axis's direction was swapped. The spot has not moved: the position changes sign."""
        self.millisteps = -self.millisteps
        self.target = -self.target
        self.home = -self.home
        self.mirror_gap()

    # ---- the backlash: where in its gap the drive stands

    def lose_gap(self):
        """Nobody knows where in the gap the drive stands: nothing is taken up until it is found."""
        self.gap_known = False
        self.inside = 0
        self._way = 0  # the direction of the last drive ...
        self._one_way = 0  # ... and how much went that way, to find an end of the gap

    def take_up(self, direction):
        """What must be driven in this direction before the mirror moves, as far as is known."""
        if not self.gap_known:
            return 0
        return self.gap - self.inside if direction > 0 else self.inside

    def taken_up(self, direction):
        """The drive has turned through the gap."""
        self.inside = self.gap if direction > 0 else 0

    def through_gap(self, direction, amount):
        """The drive has turned by this amount. Returns what of it has moved the mirror."""
        if self.gap_known:
            left = self.take_up(direction)
            if amount < left:
                self.inside += direction * amount
                return 0
            self.taken_up(direction)
            return amount - left
        if direction != self._way:
            self._way = direction
            self._one_way = 0
        self._one_way += amount
        if self._one_way >= self.gap:
            self.gap_known = True
            self.taken_up(direction)
        return amount

    def mirror_gap(self):
        """The axis's direction was swapped."""
        self.inside = self.gap - self.inside if self.gap_known else 0
        self._way = -self._way
