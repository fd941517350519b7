"""An axis told in counts instead of steps (`SN1`): where it is, and its moves. Imports axis, codes, settings."""

from mountfw import codes
from mountfw.motion.axis import ASK
from mountfw.settings import MAX_STEPS


class InCounts:
    """Of one EncodedAxis. Moves return False if they are refused; an error says why."""

    def __init__(self, axis):
        self._axis = axis
        self.reset()

    def reset(self):
        """As at power-up."""
        self.target = self.relative = self.defined = 0  # as they were said

    def now(self):
        """The position, signed, in the axis's own direction."""
        self._axis.position_now()
        return self._axis.measured.in_counts()

    def move_by(self, n):
        """Move by n counts; in the open loop to the nearest step."""
        return self._move(self.now() + n, n, None)

    def move_to(self, counts):
        """Move to a position; in the open loop to the nearest step."""
        return self._move(counts, counts - self.now(), self._axis.measured.place)

    def _move(self, target, n, start):
        if not self._begin(target, n, start):
            return False
        self.target = target
        self.relative = n
        return True

    def _begin(self, target, n, start):
        if not self._axis.measured.closed:
            return self._axis.move_to(self._steps(target))
        if not self._axis.handle(ASK, 0) or self._out_of_reach(target):
            return False
        return self._axis.turn(n, start, self._steps(target))

    def _steps(self, counts):
        """The nearest step."""
        per_step = self._axis.measured.per_step
        return (counts + (per_step >> 1)) // per_step

    def _out_of_reach(self, counts):
        per_step = self._axis.measured.per_step
        return self._axis.out_of_reach(counts // per_step, -(-counts // per_step))

    def define(self, counts):
        """The position here is so many counts."""
        axis = self._axis
        if axis.state:
            axis.error(codes.AXIS_MOVING)
            return False
        if abs(counts) // axis.measured.per_step >= MAX_STEPS:
            axis.error(codes.AXIS_OUT_OF_RANGE)
            return False
        if axis.drive.on_flash:
            axis.drive.drop_record()
        if not axis.drive.on_flash:
            axis.measured.define_counts(counts)
            self.defined = self.target = counts
            axis.has_moved = True
        return True
