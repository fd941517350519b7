"""What happens in a soak: episodes of random commands and faults, and what must hold in them.

An episode is a seed: what it sends and when follows from it and from nothing else. It begins with the default
settings and the motors at rest, and ends with the motors at rest and everything counted.
Ctrl-C (0x03) is never sent: it belongs to the interpreter and would end the firmware.
"""

import random
import re
from collections import Counter
from collections.abc import Callable, Set
from dataclasses import dataclass, field

from lab import ENABLES, LOST, Board, first_low_us, last_fall_us, on_times_us

from mirrormount.device.mount import encode_frame
from mirrormount_sim.profiles import SWITCH_REV

# ---- messages, good and bad; all choices are the given generator's

_SETTINGS = (("XP", 200, 2_000_000), ("XD", 1, 255), ("XV", 1, 255), ("XM", 1, 400_000), ("XT", 1, 400_000))
_FLAGS = (("XI", 1), ("XL", 3), ("ZH", 1))
_QUERIES = (
    *("*IDN?", "VE?", "TE?", "TB?", "PH?", "XS?", "XK?", "XF?"),
    *("TP?", "PA?", "PR?", "MV?", "MD?", "DH?", "VA?", "XP?", "XD?", "XV?", "XI?", "XL?", "XM?", "XT?", "XE?", "ZH?"),
)
_ENDS = (b"\n", b"\r", b"\r\n")


def frame(r: random.Random) -> bytes:
    """A good frame, with or without a line end."""
    m1, m2 = (r.choice((0, 255, -255, r.randrange(-255, 256))) for _ in range(2))
    text = encode_frame(m1, m2)
    if r.random() < 0.1:
        text = text.replace(b"0", b"+", 1) if text[:1] == b"0" else text
    return text + r.choice((b"", b"", *_ENDS))


def line(r: random.Random) -> bytes:
    """A line that is well formed; not all of it can be done."""
    text = ";".join(_command(r) for _ in range(r.choice((1, 1, 1, 2, 3, 5))))
    if r.random() < 0.1:
        text = f"{r.randrange(32)}>{text}"
    if r.random() < 0.1:
        text = text.lower()
    return text.encode() + r.choice(_ENDS)


def _command(r: random.Random) -> str:
    axis = r.choice(("1", "1", "1", "2", "2", "2", "3", "9", ""))
    kind = r.random()
    if kind < 0.35:
        return _motion(r, axis)
    if kind < 0.6:
        return r.choice((axis, axis, "")) + r.choice(_QUERIES)
    if kind < 0.7:
        name, most = r.choice(_FLAGS)
        return f"{axis}{name}{r.randrange(most + 1)}"
    if kind < 0.8:
        return f"XK{r.choice((0, r.randrange(20, 3000)))}"
    if kind < 0.95:
        name, least, most = r.choice(_SETTINGS)
        return f"{axis}{name}{round(least * (most / least) ** r.random())}"
    return r.choice(("AT", f"{axis}XP1", f"{axis}PR", f"{axis}VA0", f"{axis}OR", "ZZ9", f"{axis}XM400001"))


def _motion(r: random.Random, axis: str) -> str:
    return r.choice(
        (
            f"{axis}PR{r.randrange(-20, 21)}",
            f"{axis} PR {r.randrange(-3, 4)}",
            f"{axis}PA{r.randrange(-50, 51)}",
            f"{axis}PR{r.randrange(-2_000_000, 2_000_001)}",
            f"{axis}MV{r.choice('+-')}",
            f"{axis}MV{r.choice('+-')}",
            f"{axis}ST",
            "ST",
            "AB",
            f"{axis}DH{r.randrange(-1000, 1000)}",
            f"{axis}VA{r.randrange(1, 5000)}.{r.randrange(100):02d}",
        )
    )


def malformed(r: random.Random) -> bytes:
    """A message that was damaged on its way, or noise; now and then it is still a good one."""
    if r.random() < 0.3:
        return bytes(r.choice((*range(3), *range(4, 256))) for _ in range(r.randrange(1, 40)))
    data = bytearray(good_message(r))
    for _ in range(r.choice((1, 1, 2))):
        i = r.randrange(len(data))
        data[i : i + r.randrange(2)] = bytes(
            r.choice(b"0123456789+-;?!XPRMV\n \x00\xff") for _ in range(r.randrange(2))
        )
        data = data or bytearray(b"#")
    return bytes(data)


def good_message(r: random.Random) -> bytes:
    """A frame or a line."""
    return r.choice((frame, line))(r)


def any_message(r: random.Random) -> bytes:
    """A good one, or a damaged one."""
    return r.choice((good_message,) * 4 + (malformed,))(r)


# ---- moves whose end is checked: what is asked for, what may cut it short, what must have come of it

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
_BY_FRAME = "frame"
_PULSES_US = 1_100_000  # between two pulses at most: a switch shows at the next one


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
        End(_BY_FRAME, "0255-255", 10_000, frozenset({_SUPERSEDED}), frozenset({140, 240})),
        End(HIT, "", _PULSES_US, frozenset({_END_STOP}), frozenset({axis * 100 + (4 if way > 0 else 5)})),
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
        if self.end.name == _BY_FRAME:  # what the frame drove is in what the pin showed
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


# ---- the episode

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
        self._say("frames", frame(self._random))

    def _line(self) -> None:
        self._say("lines", line(self._random))

    def _malformed(self) -> None:
        self._say("malformed", malformed(self._random))

    def _split(self) -> None:
        """A message in pieces; a pause may be long enough to make it two."""
        whole = any_message(self._random)
        cuts = sorted(self._random.randrange(len(whole) + 1) for _ in range(self._random.randrange(1, 4)))
        self._tally.commands["split"] += 1
        for start, end in zip([0, *cuts], [*cuts, len(whole)], strict=True):
            self._give(whole[start:end])
            self._run(self._random.choice((0, 200, 2_000, 20_000, 49_000, 70_000)))

    def _burst(self) -> None:
        """Many messages at once, good ones or any; often a stop is the last of them."""
        random = self._random
        kind = random.choice((frame, good_message, any_message))
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
            self._give(any_message(random)[:-1])
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
