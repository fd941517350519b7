"""What happens in a soak: episodes of random commands and faults, and what must hold in them.

An episode is a seed: what it sends and when follows from it and from nothing else. It begins with the default
settings and the motors at rest, and ends with the motors at rest and everything counted.
"""

import random
import re
from collections import Counter
from collections.abc import Callable, Set
from dataclasses import dataclass, field

import messages
from lab import ENABLES, LOST, Board, first_low_us, last_fall_us, on_times_us
from moves import HIT, SILENCE, Move

from mirrormount.virtual.mechanics import SWITCH_REV

STOP_US = 1_000  # from a stop to both enables low
BYTE_US = 40  # for each byte ahead of it

_KEEP_ALIVE_LATE_US = 5_000
_PATIENCE_US = 3_000_000  # for a stop that is late: how late?
_NIGHT_US = (5_000_000, 40_000_000)  # at rest after each episode
_SIDES = tuple(f"m{axis}_sw_{side}" for axis in (1, 2) for side in ("pos", "neg"))


class Hung(Exception):
    """The board does not answer any more."""


@dataclass
class Violation:
    """Something that must not happen: what, and all that the episode had done until then."""

    episode: int
    at_us: int
    what: str
    log: list[str]


@dataclass
class Tally:
    """What happened so far, in all episodes."""

    episodes: int = 0
    commands: Counter[str] = field(default_factory=Counter)
    faults: Counter[str] = field(default_factory=Counter)
    stops: Counter[str] = field(default_factory=Counter)
    moves: Counter[str] = field(default_factory=Counter)  # those whose end was checked, by what they came to
    errors: Counter[int] = field(default_factory=Counter)
    drives: int = 0  # times that a leg went high
    received: int = 0  # by the board, bytes
    worst_stop_us: float = 0  # with nothing ahead of it
    worst_byte_us: float = 0  # for each byte, with at least 100 ahead of it
    memory: list[int] = field(default_factory=list)
    passes: int = 0
    resets: int = 0
    violations: list[Violation] = field(default_factory=list)

    def memory_sinks(self) -> bool:
        """True if there was less at every time of the second half than at any of the first."""
        half = len(self.memory) // 2
        return half >= 4 and max(self.memory[half:]) < min(self.memory[:half])


class Episode:
    """Episode `number` of the soak `seed`, on a board that goes on from the one before. run() it once."""

    def __init__(self, board: Board, tally: Tally, seed: int, number: int, stop_us: int, byte_us: int) -> None:
        self._board = board
        self._tally = tally
        self._number = number
        self._random = random.Random(f"{seed}/{number}")
        self._stop_us = stop_us
        self._byte_us = byte_us
        self._log: list[str] = []
        self._began_us = board.us
        self._taken_us = 0  # when the board must have taken in all that it was given
        self._low_from_us: float | None = None  # nothing may drive from then on, until something is given

    def run(self, boot_id: int) -> int:
        """Run it. boot_id is the board's before, or 0; returns the one after. Raises Hung."""
        self._rest()
        self._place(0.0, 0.0)
        for axis in (1, 2):
            self._obey(f"{axis}XP20000;{axis}VA20;{axis}XD255;{axis}XV255;{axis}XI0;{axis}XL3;{axis}XM10000")
            self._obey(f"{axis}XT120000;{axis}ZH0;{axis}DH0;XK0")
        self._rest()
        actions = self._actions()
        for _ in range(self._random.randrange(20, 50)):
            (action,) = self._random.choices(list(actions), list(actions.values()))
            action()
            self._pause()
        self._rest()
        self._low_from_us = self._board.us
        self._run(self._random.randrange(*_NIGHT_US))
        self._stayed_low()
        self._tally.episodes += 1
        return self._count(boot_id)

    def _actions(self) -> dict[Callable[[], None], int]:
        """What may happen, and how often."""
        return {
            self._frame: 8,
            self._line: 10,
            self._malformed: 4,
            self._split: 5,
            self._burst: 3,
            self._stop: 10,
            self._deaf: 2,
            self._closed: 2,
            self._cut_off: 1,
            self._switch: 2,
            self._near_end: 2,
            self._idle: 2,
            self._move: 8,
        }

    # ---- what is sent

    def _frame(self) -> None:
        self._say("frames", messages.frame(self._random))

    def _line(self) -> None:
        self._say("lines", messages.line(self._random))

    def _malformed(self) -> None:
        self._say("malformed", messages.malformed(self._random))

    def _split(self) -> None:
        """A message in pieces; a pause may be long enough to make it two."""
        whole = messages.any_message(self._random)
        cuts = sorted(self._random.randrange(len(whole) + 1) for _ in range(self._random.randrange(1, 4)))
        self._tally.commands["split"] += 1
        for start, end in zip([0, *cuts], [*cuts, len(whole)], strict=True):
            self._give(whole[start:end])
            self._run(self._random.choice((0, 200, 2_000, 20_000, 49_000, 70_000)))

    def _burst(self) -> None:
        """Many messages at once, good ones or any; often a stop is the last of them."""
        random = self._random
        kind = random.choice((messages.frame, messages.good_message, messages.any_message))
        self._say(
            "bursts", b"".join(kind(random) for _ in range(random.randrange(3, 150)))[: random.randrange(50, 1500)]
        )
        if random.random() < 0.7:
            self._check_stop()

    def _say(self, kind: str, data: bytes) -> None:
        self._tally.commands[kind] += 1
        self._give(data)

    # ---- stops

    def _stop(self) -> None:
        """A stop, mostly of something, and sometimes in the middle of a message."""
        random = self._random
        if random.random() < 0.6:
            self._give(random.choice((b"0255-255", b"-1000100\n", b"1MV-;2MV+\n", b"1PR9;2PR-9\n", b"2PR3\n")))
            self._run(random.randrange(100_000))
        if random.random() < 0.3:
            self._give(messages.any_message(random)[:-1])
            self._run(random.choice((0, 0, 1_000, 10_000)))
        self._check_stop()

    def _check_stop(self) -> None:
        """Both enables must be low in time, and stay so until something else is said."""
        random = self._random
        kind = random.choice(("!", "zeros"))
        stop = b"00000000" if kind == "zeros" else random.choice((b"!", b"!\n"))
        at_once = random.random() < 0.3  # something else comes right behind it
        high = [pin for pin in ENABLES if self._board.simulation.bench.duties()[pin]]
        ahead_us = max(0, self._taken_us - self._board.us)
        self._tally.stops[kind] += 1
        landed_us = self._give(stop + (b"\n0255-255" if at_once else b""))
        limit_us = self._stop_us + ahead_us + self._byte_us * len(stop)
        self._run(limit_us + random.randrange(2_000, 30_000))
        edges = self._board.edges
        if at_once:
            self._board.run(_PATIENCE_US, lambda: first_low_us(edges, landed_us, high) < LOST)
            late_us = first_low_us(edges, landed_us, high) - landed_us
        else:
            self._board.run(_PATIENCE_US, self._board.off)
            late_us = last_fall_us(edges, landed_us) - landed_us if self._board.off() else LOST
            self._low_from_us = landed_us + late_us
        if late_us > limit_us:
            self._violated(f"{stop!r} took {late_us} us, {limit_us} us allowed")
        if not ahead_us:
            self._tally.worst_stop_us = max(self._tally.worst_stop_us, late_us)
        elif ahead_us > 100 * self._byte_us:
            per_byte_us = late_us / (ahead_us / self._byte_us)
            self._tally.worst_byte_us = max(self._tally.worst_byte_us, per_byte_us)

    # ---- faults, and nothing

    def _deaf(self) -> None:
        """The host stops reading, or reads again."""
        self._fault("host stops reading" if not self._board.deaf else "host reads again")
        self._board.hear(self._board.deaf)

    def _closed(self) -> None:
        """The port is closed and opened again; what is under way goes on."""
        self._fault("port closed")
        self._board.simulation.opened(False)
        self._run(self._random.choice((1_000, 50_000, 700_000)))
        self._note("port opened")
        self._board.simulation.opened(True)

    def _cut_off(self) -> None:
        """A keep-alive, a motion, and a host that is gone: it must end by itself."""
        self._rest()
        keep_ms = self._random.randrange(50, 800)
        landed_us = self._give(b"XK%d;1MV+;2MV-\n" % keep_ms)
        self._fault("host cut off")
        self._board.hear(False)
        self._board.simulation.opened(False)
        self._run(keep_ms * 1000 + 50_000)
        late_us = last_fall_us(self._board.edges, landed_us) - landed_us - keep_ms * 1000
        if not self._board.off() or late_us > _KEEP_ALIVE_LATE_US:
            self._violated(f"XK{keep_ms}: the motors were off {late_us} us late")
        self._rest()

    def _switch(self) -> None:
        """The wire of an end-stop breaks, or is whole again."""
        broken = self._board.simulation.bench.broken
        if broken and self._random.random() < 0.5:
            self._fault("end-stop wire mended")
            broken.discard(self._random.choice(sorted(broken)))
        else:
            self._fault("end-stop wire cut")
            broken.add(self._random.choice(_SIDES))

    def _near_end(self) -> None:
        """The screws stand shortly before their end-stops, and are driven there."""
        way = self._random.choice((-1, 1))
        self._fault("driven to the end")
        near = way * (SWITCH_REV - self._random.uniform(0.001, 0.02))
        self._place(near, near)
        self._give(b"0255" * 2 if way > 0 else b"-255" * 2)
        self._run(self._random.randrange(50_000, 300_000))

    def _idle(self) -> None:
        self._tally.commands["idle times"] += 1
        self._run(round(10 ** self._random.uniform(4.5, 7)))

    def _move(self) -> None:
        """A move that something may cut short: how it ended must fit what the pins had."""
        self._rest()
        self._place(0.0, 0.0)
        move = Move.chosen(self._random)
        for line in move.settings():
            self._obey(line)
        before = self._position(move.axis)
        self._board.forget()
        self._give(move.start().encode() + b"\n")
        self._run(move.end_after_us)
        if move.end.says:
            self._give(move.end.says.encode())
        elif move.end.name in (HIT, SILENCE):
            self._fault(move.end.name)
        if move.end.name == HIT:
            self._board.simulation.bench.broken.add(f"m{move.axis}_sw_{'pos' if move.way > 0 else 'neg'}")
        self._run(move.end.wait_us)
        reason, done, counted_us = self._numbers(f"{move.axis}XE?")
        pin_us = on_times_us(self._board.edges, f"m{move.axis}_en")
        moved = self._position(move.axis) - before
        for wrong in move.complaints(reason, done, counted_us, moved, pin_us):
            self._violated(
                f"{move.start()}, then {move.end.name}: {wrong} is wrong: reason {reason}, {done} steps,"
                f" {counted_us} us, {moved / 1000} steps further; on the pin {pin_us} us"
            )
        self._tally.moves[f"reason {reason}"] += 1
        self._rest(move.errors())

    # ---- inside

    def _give(self, data: bytes) -> int:
        self._stayed_low()
        self._note(repr(data))
        self._taken_us = max(self._taken_us, self._board.us) + self._byte_us * len(data)
        self._tally.received += len(data)
        return self._board.give(data)

    def _run(self, us: int) -> None:
        self._board.run(us)

    def _pause(self) -> None:
        self._run(self._random.choice((0, 0, 500, 5_000, 50_000, 400_000)) * self._random.randrange(1, 100) // 100)

    def _note(self, what: str) -> None:
        self._log.append(f"{self._board.us - self._began_us} {what}")

    def _fault(self, what: str) -> None:
        self._note(what)
        self._tally.faults[what] += 1

    def _violated(self, what: str) -> None:
        self._tally.violations.append(Violation(self._number, self._board.us - self._began_us, what, [*self._log]))

    def _stayed_low(self) -> None:
        """Nothing may have driven since a stop, or at rest."""
        if self._low_from_us is None:
            return
        edges = self._board.edges
        rises = [edge for edge in edges if edge[0] > self._low_from_us and edge[1] in ENABLES and edge[2]]
        self._low_from_us = None
        if rises or not self._board.off():
            self._violated(f"a motor came on by itself: {rises[:3]}")

    def _place(self, vertical: float, horizontal: float) -> None:
        """Put the screws somewhere, in revolutions."""
        bench = self._board.simulation.bench
        for train, rev in ((bench.vertical, vertical), (bench.horizontal, horizontal)):
            train.screw_rev = train.shaft_rev = rev
            train.rev_s = 0.0

    def _rest(self, may_say: Set[int] | None = None) -> None:
        """Host and motors at rest, everything answered. may_say: the errors that may wait; None: any. Raises Hung."""
        self._note("at rest")
        self._board.hear(True)
        self._board.simulation.opened(True)
        self._board.simulation.bench.broken.clear()
        self._give(b"!\n")
        if not self._board.catch_up():
            self._violated("the board does not answer any more")
            raise Hung
        if not self._board.off():
            self._violated("at rest, and a motor is driven")
        self._taken_us = 0
        while code := self._numbers("TE?")[0]:
            self._tally.errors[code] += 1
            if code == 64 or (may_say is not None and code not in may_say):
                self._violated(f"error {code}")
        self._tally.drives += sum(1 for _, pin, duty in self._board.edges if duty and not pin.endswith("_en"))
        self._board.forget()

    def _obey(self, line: str) -> None:
        self._give(line.encode() + b"\n")
        self._board.catch_up()

    def _numbers(self, query: str) -> list[int]:
        """The numbers of an answer, whatever stands between them. Raises Hung if there is none."""
        self._note(query)
        answer = self._board.ask(query.encode())
        if not re.fullmatch(r"-?\d+([,|]-?\d+)*", answer):
            self._violated(f"{query} is answered {answer!r}")
            raise Hung
        return [int(n) for n in re.split("[,|]", answer)]

    def _position(self, axis: int) -> int:
        return self._numbers("XS?")[(3, 9)[axis - 1]]

    def _count(self, boot_id: int) -> int:
        """At the end: no reset, nothing moving, how much memory there is."""
        new_id, _, _, _, moving1, _, _, _, _, _, moving2, *_ = self._numbers("XS?")
        if boot_id and new_id != boot_id:
            self._tally.resets += 1
            self._violated("the board has been reset")
        if moving1 or moving2:
            self._violated("at rest, and an axis moves")
        free, _, self._tally.passes, _, _ = self._numbers("XH?")
        self._tally.memory.append(free)
        return new_id
