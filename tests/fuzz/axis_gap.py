"""The place of the drive in the backlash, for axis_model.py."""


class Unclear(Exception):
    """Both outcomes are right, within the tolerance: this session cannot be judged any further."""


class Gap:
    """An interval 0 ... size in microseconds x duty; size 0 is no gap.

    Where in it the drive stands is `inside`, give or take `slack`. It is known once `size` was driven one way.
    """

    def __init__(self) -> None:
        self.size = 0
        self._lose()

    def _lose(self) -> None:
        self.known = False
        self.inside, self.slack = 0.0, 0.0
        self._way, self._one_way = 0, 0.0

    def resize(self, size: int) -> None:
        """Another gap is to be found again."""
        if size != self.size:
            self.size = size
            self._lose()

    def _find(self) -> None:
        if not self.size or self.known or not self._way:
            return
        if self._one_way >= self.size + self.slack:
            self.known = True
            self.taken_up(self._way)
        elif self._one_way >= self.size - self.slack:
            raise Unclear

    def taken_up(self, way: int) -> None:
        """The drive stands at the end of the gap that lies that way."""
        self.inside = float(self.size) if way > 0 else 0.0
        self.slack = 0.0

    def need(self, way: int) -> float:
        """What must be driven that way before the mirror moves, as far as is known."""
        self._find()
        return self._left(way) if self.known else 0.0

    def _left(self, way: int) -> float:
        return self.size - self.inside if way > 0 else self.inside

    def is_near(self, way: int, amount: float) -> bool:
        """May a drive that way have come to the end, if it was longer by so much?"""
        return not self.size or not self.known or self._left(way) <= amount

    def through(self, way: int, amount: float) -> float:
        """What of a drive moves the mirror."""
        if not self.size:
            return amount
        if way != self._way:
            self._find()
        if self.known:
            self._way = way
            over = amount - self._left(way)
            if over <= 0:
                self.inside += way * amount
                return 0.0
            self.inside = float(self.size) if way > 0 else 0.0
            return over
        if way != self._way:
            self._way, self._one_way, self.slack = way, 0.0, 0.0
        self._one_way += amount
        return amount

    def loosen(self, amount: float, effect: float) -> None:
        """The last drive, which has moved the mirror by effect, may have been longer or shorter by amount."""
        if self.known and effect > self.slack + amount:
            self.slack = 0.0  # at the end of the gap it stands all the same
        elif self.size:
            self.slack += amount

    def mirror(self) -> None:
        """The axis's direction is swapped."""
        self._find()
        self.inside = self.size - self.inside if self.known else 0.0
        self._way = -self._way
