"""The backlash of an axis: where in its gap the drive stands. Pure; imports nothing.

A drive that has changed direction first turns through the gap, `gap` of it, while the mirror stands still: that much is
no part of a step. `inside` is how far the drive is from the gap's negative end, 0 ... gap. Amounts are microseconds
times duty. An axis without take-up (setting `take_up_us`) has no gap, and nothing here runs.
"""


class Backlash:
    """A part of Position."""

    gap = 0

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
