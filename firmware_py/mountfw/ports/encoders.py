"""What readers of encoders make counts of, on every platform. Pure; imports nothing of ours.

A reader has counts(), a signed integer that wraps at 2**30; slips, how often a change was seen that no shaft can
make, so that counts are missing; gone: the sensor does not answer; and play_us, for how long a drive may turn the play
of gears before the sensor does. One that knows where it stands within a turn has angle(), too.
"""

_MASK = 0x3FFF_FFFF
_HALF = 1 << 29
_TURN = 4096  # of an AS5600
_PLAY_US = 300_000  # at full drive; assumed: the paper's whole backlash is 280 ms
_MOST_SILENT = 3  # looks without an answer; then the sensor is gone


class Phases:
    """Slips of a counter of edges. take(word) of its words: count << 2 | B << 1 | A, 32 bits, signed.

    In one turn of the four phases A leads B through 00, A, AB, B, and each edge counts one. So the count and the phase
    stay together modulo four; a change of both signals at once, which counts nothing, takes them two apart.
    """

    play_us = 0

    def __init__(self):
        self.slips = 0
        self._apart = -1  # not known yet

    def take(self, word):
        """The count in a word."""
        count = word >> 2
        phase = word & 3
        apart_now = (count - (phase ^ phase >> 1)) & 3
        if apart_now != self._apart:
            if self._apart >= 0:
                self.slips = self.slips + 1 & _MASK
            self._apart = apart_now
        return count


class Turns:
    """Counts of an AS5600. take(status, high, low) of its registers STATUS and RAW ANGLE (data sheet, register map)."""

    play_us = _PLAY_US

    def __init__(self):
        self.slips = 0
        self.gone = True  # until the first answer
        self.count = 0  # its lowest 12 bits are the angle
        self._silent = 0  # looks in a row

    def angle(self):
        """The angle, 0 … 4095, when it was looked at last; -1: it does not answer."""
        return -1 if self.gone else self.count & (_TURN - 1)

    def take(self, status, high, low):
        """An answer: the shorter way round from the angle before, unless it sees no magnet."""
        if not status & 0x20:
            self.silent()
            return
        angle = (high & 15) << 8 | low
        way = (angle - self.count + (_TURN >> 1)) & (_TURN - 1)
        self.count = (self.count + way - (_TURN >> 1) + _HALF & _MASK) - _HALF
        self._silent = 0
        if self.gone:  # meanwhile it may have turned further than half a turn
            self.slips = self.slips + 1 & _MASK
            self.gone = False

    def silent(self):
        """No answer. Returns True if it is one of many: to ask each time is not worth what it takes."""
        self._silent = min(self._silent + 1, _MOST_SILENT)
        if self._silent < _MOST_SILENT:
            return False
        self.gone = True
        return True
