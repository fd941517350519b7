"""Moves of the soak whose end is checked: what is asked for, what may cut it short, what must have come of it."""

import random
from dataclasses import dataclass

# reasons why a move ended (docs/errors.md)
_DONE, _STOPPED, _ABORTED, _END_STOP, _RUN_LIMIT, _KEEP_ALIVE, _SUPERSEDED = 1, 2, 3, 4, 6, 7, 8

_NEAR_US = 1_000  # the firmware's count of time under drive, against the pin's, for each pulse


@dataclass(frozen=True)
class End:
    """What may cut a move short: something that is said, and if nothing is, a switch or the keep-alive.

    wait_us: until it must have shown. reasons and errors are those of docs/errors.md that it may leave.
    """

    name: str
    says: str
    wait_us: int
    reasons: frozenset[int]
    errors: frozenset[int] = frozenset()


HIT = "end-stop"
SILENCE = "host frozen"
_FRAME = "frame"
_REST_US = 1_100_000  # between two pulses at most: a switch shows at the next one


def _ends(axis: int, way: int, keep_ms: int) -> tuple[End, ...]:
    none = End("none", "", 20_000, frozenset())
    return (
        none,
        none,
        End("!", "!\n", 20_000, frozenset({_ABORTED})),
        End("zeros", "00000000", 20_000, frozenset({_STOPPED})),
        End("ST", f"{axis}ST\n", 270_000, frozenset({_STOPPED})),
        End("malformed", "255255\n", 20_000, frozenset({_STOPPED}), frozenset({60})),
        # the frame is a move of its own, which ends with the run limit, after 20 ms at least: so it is asked before
        End(_FRAME, "0255-255", 10_000, frozenset({_SUPERSEDED}), frozenset({140, 240})),
        End(HIT, "", _REST_US, frozenset({_END_STOP}), frozenset({axis * 100 + (4 if way > 0 else 5)})),
        End(SILENCE, "", keep_ms * 1000 + 30_000, frozenset({_KEEP_ALIVE}), frozenset({62})),
    )


@dataclass(frozen=True)
class Move:
    """Steps of one axis, or with steps 0 a run; way is 1 or -1. end comes end_after_us after the start."""

    axis: int
    way: int
    steps: int
    on_us: int
    limit_ms: int
    velocity: int  # hundredths of a step per second
    keep_ms: int
    end: End
    end_after_us: int

    @classmethod
    def chosen(cls, r: random.Random) -> "Move":
        """Any."""
        axis, way = r.choice((1, 2)), r.choice((-1, 1))
        steps = r.choice((0, r.randrange(1, 9)))
        on_us, limit_ms = r.choice((200, 1_000, 5_000, 30_000, 120_000)), r.randrange(20, 600)
        velocity = 100_000_000 // (on_us + 1_000) // r.choice((1, 2, 5))
        keep_ms = r.randrange(20, 400)
        end = r.choice(_ends(axis, way, keep_ms))
        whole_us = steps * (100_000_000 // velocity) if steps else limit_ms * 1000
        after_us = 20_000 + (whole_us if end.name == "none" else r.randrange(whole_us))
        return cls(axis, way, steps, on_us, limit_ms, velocity, keep_ms, end, after_us)

    def settings(self) -> tuple[str, str]:
        """The lines that prepare it."""
        a = self.axis
        return (
            f"{a}XP{self.on_us};{a}XD255;{a}XV255;{a}XM{self.limit_ms};{a}XT400000;{a}ZH0;{a}XL3;XK0",
            f"{a}VA{self.velocity // 100}.{self.velocity % 100:02d}",
        )

    def start(self) -> str:
        """The line that starts it."""
        way = "+" if self.way > 0 else "-"
        move = f"{self.axis}PR{way}{self.steps}" if self.steps else f"{self.axis}MV{way}"
        return f"{move};XK{self.keep_ms}" if self.end.name == SILENCE else move

    def errors(self) -> frozenset[int]:
        """Those that may wait afterwards."""
        return self.end.errors | (frozenset() if self.steps else {self.axis * 100 + 40})

    def complaints(self, reason: int, done: int, counted_us: int, moved: int, pin_us: list[int]) -> list[str]:
        """What is wrong with how it ended; nothing if all is right.

        reason, done and counted_us are XE?'s, moved is by how many thousandths of a step the position changed, pin_us
        how long the enable was high, each time.
        """
        most = sum(us >= self.on_us - _NEAR_US for us in pin_us)
        least = sum(us >= self.on_us + _NEAR_US for us in pin_us)
        if self.steps:
            by_itself, over = _DONE, most >= self.steps
        else:
            by_itself, over = _RUN_LIMIT, sum(pin_us) >= self.limit_ms * 1000 - _NEAR_US
        wrong = []
        if reason not in self.end.reasons and not (over and reason == by_itself):
            wrong.append("the reason")
        if self.end.name == _FRAME:  # what the frame drove is in what the pin showed
            if reason == _SUPERSEDED and self.steps and not least - 1 <= self.way * done <= most + 1:
                wrong.append("the steps")
            return wrong
        if self.steps and not least <= self.way * done <= most:
            wrong.append("the steps")
        if abs(counted_us - sum(pin_us)) > _NEAR_US * (len(pin_us) + 1):
            wrong.append("the time")
        if reason == _DONE and moved != self.way * self.steps * 1000:
            wrong.append("the position")
        return wrong
