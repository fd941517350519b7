"""A move of the closed loop: each pulse until its counts are there, then corrections. Imports codes, ticks, watch.

Its goal is a place (counts that have moved the mirror, position.py), so what one pulse misses the next one makes up
for. The drive is cut early by what the motor coasts on, which is learned from the place where it came to rest: for each
direction, and in proportion to the speed. The end of a drive is foretold from the speed, and the loop waits for it as
for the end of any drive. A drive of a few counts may be over before a speed is known, or between two looks: a
correction makes up for what it turns too far.
"""

from mountfw import codes, const
from mountfw.encoder.watch import FULL_SPEED_US
from mountfw.wire.ticks import diff as apart  # counts wrap as times do

MOST_CORRECTIONS = const(3)
_LONGER = const(2)  # a pulse is cut after the time that its counts are worth, plus so many times that time, ...
_MOST_LONGER_US = const(150_000_000)  # ... where this second part is at most so long, ...
_MORE_US = const(50_000)  # ... plus this
_MOST_US = const(250_000_000)  # what a drive's counts may be worth: its bound is no longer than any other drive's
_NEAR_US = const(60_000)  # of drive at a step's speed
_MOST_COAST = const(4)  # at most that part of a step
_LEAST_BACK = const(16)  # that part of a step is the least correction back through the play of gears; assumed


class Coast:
    """What one direction coasts on, in sixteenths of a count, at a speed (Watch.rate())."""

    def __init__(self):
        self.forget()

    def forget(self):
        """Nothing is known."""
        self._coast = 0
        self._rate = 0

    def known(self):
        """True if it was learned."""
        return self._rate > 0

    def at(self, rate):
        """What it coasts on from this speed."""
        return self._coast * rate // self._rate if self._rate else 0

    def learn(self, was, rate, missed, most):
        """From this speed it was cut `was` early, and came to rest `missed` counts beyond the goal. At most `most`."""
        missed *= 16
        if self._rate:
            missed >>= 2  # a pulse's own scatter
        self._coast = min(max(0, was + missed), most)
        self._rate = rate


class ClosedLoop:
    """The move of one axis. Directions are 1 and -1."""

    def __init__(self):
        self.goal = 0  # a place
        self.left = 0  # pulses to go
        self.way = 0  # counts of the next drive, signed
        self.corrections = 0
        self.target = 0  # counts of the drive at which it is there
        self.was = 0  # it was cut so early (sixteenths), ...
        self.rate = 0  # ... from this speed
        self.foretold = False  # is the drive's end that of its counts?
        self._dead_band = 0
        self._back_band = 0  # where it would have to go back
        self._per_step = 1
        self._step_us = 1
        self._duty = 0
        self._near = 0  # counts
        self._per_pulse = 0  # counts, signed
        self._learns = self._will_learn = False
        self._drove = False  # was a drive begun?
        self._direction = 0
        self._coasts = (Coast(), Coast())
        self._coast = self._coasts[0]  # that of the next drive

    def set_up(self, dead_band, per_step, step_us, duty, play):
        """The settings are these now. With another step, what was learned is forgotten. play: are gears in between?"""
        self._dead_band = dead_band
        self._back_band = max(dead_band, per_step // _LEAST_BACK) if play else dead_band
        if per_step != self._per_step or step_us != self._step_us or duty != self._duty:
            self._forget()
        self._per_step = per_step
        self._step_us = step_us
        self._duty = duty
        self._near = per_step * _NEAR_US // step_us + 8  # it starts up, too

    def start_afresh(self, place):
        """What was learned may be of the motor's other direction, or of long ago. It is at this place."""
        self._forget()
        self.goal = place

    def _forget(self):
        self._coasts[0].forget()
        self._coasts[1].forget()

    def begin(self, place, start, n, per_pulse):
        """A move by n pulses of per_pulse counts each, from the place `start`, which is near. Returns n.

        start is None: from the goal of the last move if the axis is still near it, else from `place`. Without pulses
        (n is 0) the move only corrects: its direction, 1 or -1, is returned, or 0 if the axis is near enough.
        """
        if start is not None:
            self.goal = start
        elif not self._within(apart(self.goal, place)) or self._far(apart(self.goal, place)):
            self.goal = place
        if not (n and per_pulse):
            per_pulse = 0
            way = apart(self.goal, place)
            n = 0 if self._within(way) else 1 if way > 0 else -1
        self.left = abs(n)
        self._per_pulse = per_pulse if n > 0 else -per_pulse
        self.corrections = 0
        self._learns = self._drove = False
        return n

    def next(self, place):
        """What comes next: 0 is a drive that moves the mirror by self.way counts; else the reason why it ends."""
        if self._learns:
            self._learns = False
            self._learn(apart(place, self.goal) * self._direction)
        if self._drove and not self.foretold:
            return codes.FOLLOWING
        self._drove = False
        self.way = 0
        while self.left and not self.way:
            self.left -= 1
            self.goal = apart(self.goal + self._per_pulse, 0)
            self.way = apart(self.goal, place)
        if self.way:
            return 0
        self.way = apart(self.goal, place)
        if self._within(self.way):
            return codes.DONE
        if self.corrections == MOST_CORRECTIONS:
            return codes.CLOSED_LOOP_FAILED
        self.corrections += 1
        return 0

    def _within(self, way):
        """Is the way that is left to the goal so short that it is not corrected?

        A correction back through the play of gears comes out of it at full speed: it cannot be less than what the
        motor coasts on, and would miss the goal on its other side.
        """
        band = self._back_band if way * self._direction < 0 else self._dead_band
        return -band <= way <= band

    def _far(self, way):
        """Is it half a step or more away? A dead band may be larger."""
        return not -self._per_step < way * 2 < self._per_step

    def _learn(self, missed):
        most = self._per_step * 16 // _MOST_COAST
        self._coasts[self._direction > 0].learn(self.was, self.rate, missed, most)

    def aim(self, direction, counts):
        """A drive begins: so many counts of the motor."""
        self._direction = direction
        coast = self._coasts[direction > 0]
        self._coast = coast if coast.known() else self._coasts[direction < 0]
        self.target = counts
        self.foretold = False
        self._drove = True
        self._will_learn = self._worth_us() > min(FULL_SPEED_US, self._step_us)  # a short step is all there is

    def _worth_us(self):
        """How long a drive to the target takes at a step's speed."""
        count_us = self._step_us // self._per_step + 1
        return min(self.target, _MOST_US // count_us) * count_us

    def near(self, counts):
        """May the drive be over before the second of two looks in a run?"""
        return self.target - counts <= self._near

    def bound_us(self, play_us):
        """The longest that it may take, where a drive of play_us may turn nothing but the play of gears."""
        us = self._worth_us()
        return us + min(us * _LONGER, _MOST_LONGER_US) + _MORE_US + play_us

    def cut_in(self, watch):
        """Microseconds until the drive is to be cut; -1 if that is far."""
        left = self.target - watch.counts
        if left > 500:
            return -1
        rate = watch.rate()
        coast = self._coast.at(rate)
        sixteenths = left * 16 - coast
        us = 0 if sixteenths <= 0 else watch.until(sixteenths)
        if us >= 0:
            self.foretold = True
            self.was = coast
            self.rate = rate
            self._learns = self._will_learn and rate > 0
        return us
