"""Counts the edges of two inputs in quadrature, as the hardware of a board does."""

import _seam

# from the levels before (A + 2 B) to those now: 1 where A leads, -1 where B does; both at once cannot be counted
_STEP = (0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0)


class Quadrature:
    """`count`: signed, since it was made. levels: A + 2 B now."""

    def __init__(self, a, b):
        s = _seam.seam
        self._a = a
        self._b = b
        self.count = 0
        self.levels = self._now()
        s.counters[a] = s.counters[b] = self._changed

    def _now(self):
        levels = _seam.seam.levels
        return levels.get(self._a, 1) + 2 * levels.get(self._b, 1)  # pulled up

    def _changed(self, _number, _level):
        now = self._now()
        self.count += _STEP[4 * self.levels + now]
        self.levels = now
