"""The encoder of an axis: is there one, what it counts, how many counts are a step. Imports moves, settings."""

from dataclasses import dataclass, replace

from mirrormount.common.errors import BoardError, EncoderFault, NotSupported
from mirrormount.common.validation import whole_number
from mirrormount.device import settings
from mirrormount.device.moves import Moves
from mountfw import codes as wire

_WRAP = 1 << 20  # of the board's counts
_APPROACH = 3  # steps that bring the gears to one side of their play, which an encoder behind them sees
_STEPS = 10  # that are counted, each way
_LEAST = 4  # counts of a step: with fewer no loop can be closed
_ALIKE = 0.4  # the directions may differ by so much of the larger one
_PLAY = 0.3  # of a step's counts: a smaller loss is the scatter of a timed step
_COAST = 0.04  # of a step's counts: what a motor coasts, on the bench
_SETTLED_S = 0.2  # after a move: it does not coast any more


@dataclass(frozen=True)
class Counted:
    """Counts of one step, timed, in the motor's own positive direction: the mean of both, and each of them.

    Negative: the encoder counts down there. per_step is what the setting counts_per_step takes. lost: counts that the
    first step after the reversal misses, the play that the encoder sees: about 0 for one on the motor.
    """

    per_step: int
    positive: float
    negative: float
    lost: float = 0.0

    @property
    def sees_play(self) -> bool:
        """Is it behind the gears?"""
        return self.lost > _PLAY * abs(self.per_step)

    @property
    def settings(self) -> dict[str, int]:
        """What closes the loop of that axis. One that sees play cannot correct by less than its motor coasts."""
        dead_band = max(1, round(_COAST * abs(self.per_step))) if self.sees_play else 1
        return {"counts_per_step": self.per_step, "dead_band": dead_band, "closed_loop": 1}


class Encoded(Moves):
    """What an axis has where an encoder is fitted."""

    __slots__ = ()

    @property
    def has_encoder(self) -> bool:
        """Does the board say that one is fitted? Raises ConnectionLost, NoAnswer."""
        return settings.has_encoder(self._session, self.number)

    @property
    def counts(self) -> int:
        """What the encoder has counted, from an arbitrary zero; wraps at 2^19.

        Raises NotSupported without one, EncoderFault if it does not answer or sees no magnet.
        """
        if not self.has_encoder:
            raise NotSupported(f"{self.name} has no encoder, as far as the board's file says")
        try:
            answer = self._session.send(f"{self.number}XC?")
        except BoardError as e:
            if e.code % 100 != wire.AXIS_ENCODER_LOST:
                raise
            raise EncoderFault(f"{self.name}: the encoder does not answer, or sees no magnet") from e
        return whole_number(int(answer), _WRAP, "a count")

    def measure_counts(self, n: int = _STEPS) -> Counted:
        """Find out which way the encoder counts, and how many counts a timed step has, by n steps one way and back.

        Each way begins with three steps that are not counted, so the screw turns by n + 3 steps and back. The loop is
        open meanwhile; the settings are then as they were. Raises EncoderFault if the counts cannot be this motor's,
        and as step() does.
        """
        n = whole_number(n, 1000, "steps to count")
        _ = self.counts  # there is one
        before = settings.read(self._session)[self.name]
        was = {name: before[name] for name in ("closed_loop", "units") if name in before}
        try:
            settings.write(self._session, {self.name: dict.fromkeys(was, 0)})
            way = -1 if before["inverted"] else 1
            forward, _ = self._counts_of(n)
            back, first = self._counts_of(-n)
        finally:
            settings.put_back(self._session, {self.name: was})
        found = judged(self.name, way * forward / n, -way * back / n)
        return replace(found, lost=max(0.0, abs(back / n) - abs(first)))

    def _counts_of(self, n: int) -> tuple[int, int]:
        """The counts of n steps after an approach in their direction, and of the approach's first step."""
        one = 1 if n > 0 else -1
        first, _, counted = [self._counts_by(steps) for steps in (one, one * (_APPROACH - 1), n)]
        return counted, first

    def _counts_by(self, n: int) -> int:
        before = self.counts
        self.step(n)
        self._session.sleep(_SETTLED_S)
        return counts_between(before, self.counts)


def counts_between(before: int, after: int) -> int:
    """The way from one count to a later one, across the wrap."""
    return (after - before + _WRAP // 2) % _WRAP - _WRAP // 2


def judged(name: str, positive: float, negative: float) -> Counted:
    """The counts of a step either way, if they can be. Raises EncoderFault."""
    found = f"{positive:.1f} counts a step one way, {negative:.1f} the other"
    if abs(positive) < _LEAST and abs(negative) < _LEAST:
        raise EncoderFault(f"{name}: the encoder counts nothing while the motor has drive ({found})")
    if positive * negative <= 0:
        raise EncoderFault(f"{name}: the encoder counts the same way whichever way the motor turns ({found})")
    if abs(positive - negative) > _ALIKE * max(abs(positive), abs(negative)):
        raise EncoderFault(f"{name}: the encoder counts much more one way than the other ({found})")
    return Counted(round((positive + negative) / 2), positive, negative)
