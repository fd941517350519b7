"""Counts the edges of two inputs in quadrature, as the hardware of a board does."""

import _seam

# from the levels before (A + 2 B) to those now: 1 where A leads, -1 where B does; both at once cannot be counted
_STEP = (0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0)


class Quadrature:
    """`count`: signed, since it was made. levels: A + 2 B now."""

    def __init__(self, a, b):
        s = _seam.seam
        self._a = a
        self.count = 0
        self.levels = s.levels.get(a, 1) + 2 * s.levels.get(b, 1)  # pulled up
        s.counters[a] = s.counters[b] = self._changed

    def _changed(self, number, level):
        bit = 1 if number == self._a else 2
        now = self.levels | bit if level else self.levels & ~bit
        self.count += _STEP[4 * self.levels + now]
        self.levels = now
