"""Moves of known length on one axis: steps, pulses, positions, angles. Imports session, status, units, validation.

An interrupt (Ctrl-C, or an interrupted cell of a notebook) of a method that waits for a motion stops all motors.
"""

from collections.abc import Callable

from mirrormount.common import units
from mirrormount.common.errors import BadValue, MoveEnded, NoAnswer, NotAMount
from mirrormount.common.validation import positive_numbers, real_number, whole_number, whole_numbers
from mirrormount.device.axis_properties import AxisProperties
from mirrormount.device.session import Session
from mirrormount.device.status import AxisStatus, Ended
from mountfw import codes as wire
from mountfw.settings import MAX_STEPS

Progress = Callable[[AxisStatus], None]  # called with each status during a wait

_POLL_S = 0.05
_SLACK_S = 4.0  # beyond the computed time of a move before it counts as stuck; 2 s of it for the backlash
_SIGHT_REST_US = 50_000  # after a pulse by sight: by then the motor has come to rest
_LEAST_REST_US = 1000  # of the board, between two pulses
_SHORTEST_US, _LONGEST_US = 200, 2_000_000  # a pulse of its own length (XU)
_MOST_AMOUNT = 1_000_000_000  # of any unit


class Moves(AxisProperties):
    """The moves of one axis, and the wait for their end. number: the board's."""

    __slots__ = ("_deadline", "number")  # assigning any other name raises AttributeError

    def __init__(self, session: Session, name: str, number: int) -> None:
        super().__init__(session, name)
        self.number = number
        self._deadline = 0.0

    @property
    def position(self) -> float:
        """The counted position, in steps; status() has its certainty."""
        return self.status().position

    def status(self) -> AxisStatus:
        """The state of this axis. Raises as Mount.status()."""
        return self._session.status().by_name[self.name]

    def step(
        self, n: int, *, wait: bool = True, feed: bool = True, by_sight: bool = False, progress: Progress | None = None
    ) -> None:
        """Move by n steps. With wait, returns when they are done, else at once.

        Without wait and feed the caller keeps the move alive, as in Mount.drive(). by_sight: without the board's
        take-up, and with rests of 50 ms, for a caller that sees what moves; the board's settings stay as they are.

        Raises BadValue, BoardError if refused, MoveEnded if an end-stop, a limit or somebody else
        ended it, ConnectionLost, NoAnswer.
        """
        n = whole_number(n, MAX_STEPS, "steps")
        self._move("PR", n, n, wait, feed, progress, by_sight=by_sight)

    def pulse(
        self, us: int, *, wait: bool = True, feed: bool = True, by_sight: bool = False, progress: Progress | None = None
    ) -> None:
        """Give one pulse of |us| microseconds, 200 … 2 000 000, in the direction of its sign (`XU`).

        The backlash is taken up first, but not by_sight (as in step()). The position counts the pulse by its length,
        as an estimate. Raises as step().
        """
        self._move("XU", pulse_length(us), 1, wait, feed, progress, by_sight=by_sight)

    def move_to(
        self,
        position: float,
        unit: str = units.STEPS,
        *,
        wait: bool = True,
        feed: bool = True,
        progress: Progress | None = None,
    ) -> float:
        """Move to a position in one of units.UNITS, which may lie between two steps. Returns the one reached, in steps.

        The remainder of whole steps is one pulse of its own length (`XU`), so that a whole position is reached
        also from one between two steps, such as a jog's end; the position is an estimate then. The board's shortest
        pulse is 200 us, 0.001 of a step of 200 ms: a smaller remainder stays.
        Angles and mm go by the mean scale of both directions, as positions are shown; NotCalibrated without one.
        Without wait the nearest whole number of steps is the target, which is returned, and steps must be whole. From
        between two steps the open loop ends up to half a step beside it; `position` tells. Raises as step() does.
        """
        steps = self._steps_of(position, unit)
        if not wait:
            target = whole_number(
                steps if unit == units.STEPS else round(steps), MAX_STEPS, "position, without waiting,"
            )
            self._move("PA", target, round(target - self.position), wait, feed, progress)
            return target
        wanted = real_number(steps, MAX_STEPS, "position")
        stops = self._session.gate.last_stop()
        n, part_us = self.parts_to(wanted)
        with self._session.stopped_by_interrupt():
            if isinstance(wanted, int) and not part_us:
                self._move("PA", wanted, n, wait, feed, progress, stops)
            else:
                self._by(n, part_us, feed, progress, stops)
        return self.position

    def _steps_of(self, position: float, unit: str) -> float:
        if units.check(unit) == units.STEPS:
            return position
        amount = real_number(position, _MOST_AMOUNT, f"a position in {unit}")
        return real_number(amount / self.per_step(unit), MAX_STEPS, f"{amount:g} {unit} in steps")

    def move_by(
        self, amount: float, unit: str = units.STEPS, *, wait: bool = True, progress: Progress | None = None
    ) -> float:
        """Move by an amount of one of units.UNITS. Returns the amount that its pulses are worth.

        A part of a step is one pulse of its own length (`XU`) and makes the position an estimate; without wait, the
        nearest whole number of steps is moved, and an amount in steps must be whole. Angles and mm go by the scale of
        that direction in the calibration file (docs/calibration.md). Raises NotCalibrated without one that belongs to
        the board's present step, BadFile, and as step() does.
        """
        amount = real_number(amount, _MOST_AMOUNT, f"an amount in {units.check(unit)}")
        if unit == units.STEPS and (not wait or isinstance(amount, int)):
            self.step(whole_number(amount, MAX_STEPS, "steps"), wait=wait, progress=progress)
            return amount
        stops = self._session.gate.last_stop()
        n, part_us, worth = self.parts_of(amount, unit, whole=not wait)
        if wait:
            with self._session.stopped_by_interrupt():
                self._by(n, part_us, True, progress, stops)
        else:
            self._move("PR", n, n, wait, True, None, stops)
        return worth

    def parts_of(self, amount: float, unit: str = units.STEPS, *, whole: bool = False) -> tuple[int, int, float]:
        """How move_by() moves an amount: whole steps, the length of a pulse after them (us), what both are worth.

        whole: in whole steps, the nearest. Raises BadValue, NotCalibrated, BadFile, ConnectionLost, NoAnswer.
        """
        amount = real_number(amount, _MOST_AMOUNT, f"an amount in {units.check(unit)}")
        pulse_us, duty, inverted = self.ask_whole("XP?", "XD?", "XI?")
        per_step = 1.0 if unit == units.STEPS else self._per_step(unit, amount, (pulse_us, duty, inverted))
        steps = real_number(amount / per_step, MAX_STEPS, f"{amount:g} {unit} in steps")
        n, part_us = (round(steps), 0) if whole else _split(steps, pulse_us)
        if not (n or part_us) and amount:
            least = per_step * (0.5 if whole else _SHORTEST_US / pulse_us)
            raise BadValue(f"{amount:g} {unit} is less than the least that can be moved, {least:.3g} {unit}")
        return n, part_us, (n + part_us / pulse_us) * per_step

    def parts_to(self, steps: float) -> tuple[int, int]:
        """How move_to() moves from the present position: whole steps, and the length of a pulse after them (us).

        Raises BadValue.
        """
        steps = real_number(steps, MAX_STEPS, "position")
        (pulse_us,) = self.ask_whole("XP?")
        left = round(steps * 1000) - round(self.position * 1000)  # thousandths of a step
        return _split(left / 1000, pulse_us)

    def per_step(self, unit: str) -> float:
        """How much of a unit one step is, the mean of both directions: the scale of positions.

        Raises BadValue, NotCalibrated, BadFile, ConnectionLost, NoAnswer.
        """
        if units.check(unit) == units.STEPS:
            return 1.0
        pulse_us, duty, inverted = self.ask_whole("XP?", "XD?", "XI?")
        return sum(self._per_step(unit, way, (pulse_us, duty, inverted)) for way in (1, -1)) / 2

    def ask(self, *queries: str) -> list[str]:
        """The answers to queries of this axis: axis.ask("XP?", "VA?"). Raises BoardError, NotAMount."""
        answers = self._session.send(";".join(f"{self.number}{query}" for query in queries)).split("; ")
        if len(answers) != len(queries):
            raise NotAMount(f"not the answers to {', '.join(queries)}: {'; '.join(answers)[:80]!r}")
        return answers

    def ask_whole(self, *queries: str) -> list[int]:
        """The same for queries whose answers are whole numbers."""
        return whole_numbers(",".join(self.ask(*queries)), len(queries))

    def wait(self, progress: Progress | None = None) -> Ended:
        """Wait for the end of this axis's move. Returns how it ended.

        Raises NoAnswer (and stops) if it takes longer than it can, ConnectionLost. An interrupt stops both motors.
        """
        session = self._session
        with session.stopped_by_interrupt():
            while (status := self.status()).moving:
                if progress:
                    progress(status)
                session.keep_alive.check()
                if self._deadline and session.link.monotonic() > self._deadline:
                    session.stop()
                    raise NoAnswer(f"{self.name}: still moving when it should have ended; stopped")
                session.link.sleep(_POLL_S)
            return self.last_move()

    def last_move(self) -> Ended:
        """How this axis's last move ended."""
        reason, steps, on_us = whole_numbers(self._session.ask(f"{self.number}XE?"), 3)
        return Ended(reason, steps, on_us * 1e-6)

    def expect_end(self, longest_s: float) -> None:
        """A motion was started that ends within longest_s: wait() stops it if it does not, after some seconds more."""
        self._deadline = self._session.link.monotonic() + longest_s + _SLACK_S

    def _per_step(self, unit: str, amount: float, step: tuple[int, int, int]) -> float:
        """How much of a unit one step in the direction of amount is."""
        from mirrormount.device import calibration  # a program that stops, or counts in steps, needs no file

        scale, mirror_mrad = calibration.scale_of(
            self._session.board.id, self.number, self.name, 1 if amount > 0 else -1, calibration.Step(*step)
        )
        return units.per_step(scale, mirror_mrad, unit, self.name)

    def _by(self, n: int, part_us: int, feed: bool, progress: Progress | None, stops: int) -> None:
        """Move by n steps and one pulse of part_us, both signed, and wait."""
        if n:
            self._move("PR", n, n, True, feed, progress, stops)
        if part_us:
            self._move("XU", part_us, 1, True, feed, progress, stops)

    def _move(
        self,
        mnemonic: str,
        value: int,
        n: int,
        wait: bool,
        feed: bool,
        progress: Progress | None = None,
        stops: int | None = None,
        *,
        by_sight: bool = False,
    ) -> None:
        """Start a move of n steps. stops: gate.last_stop() at the request, None: now."""
        a, session = self.number, self._session
        stops = session.gate.last_stop() if stops is None else stops
        timing, _, in_counts = session.ask(f"{a}XP?;{a}VA?;{a}SN?").rpartition("; ")
        pulse_us, velocity = positive_numbers(timing, 2)
        if mnemonic in ("PR", "PA"):
            self._check_units(*whole_numbers(in_counts, 1))
        command = f"{a}{mnemonic}{value}"
        if by_sight:
            own, velocity = velocity, _velocity_by_sight(int(pulse_us))
            (take_up_us,) = self.ask_whole("XB?")
            command = f"{a}XB0;{a}VA{velocity:.2f};{command};{a}VA{own:.2f};{a}XB{take_up_us}"
        period_s = max(1 / velocity, pulse_us * 1e-6 + 1e-3)
        with session.stopped_by_interrupt():
            session.start(command, stops)
            self.expect_end((abs(n) + 1) * period_s)
            if wait:
                self._wait_until_done(n, progress)
            elif feed:
                session.keep_alive.start()

    def _check_units(self, in_counts: int) -> None:
        """in_counts: the answer to SN?. Raises BadValue where the board takes counts instead of steps."""
        if in_counts:
            raise BadValue(
                f"{self.name}.units is {in_counts}, so the board takes counts of its encoder for steps:"
                f" `mirrormount config set {self.name}.units 0`"
            )

    def _wait_until_done(self, wanted: int | None, progress: Progress | None = None) -> None:
        ended = self.wait(progress)
        if ended.reason != wire.DONE:
            errors = self._session.errors()
            codes = tuple(error.code for error in errors)
            raise MoveEnded(self.name, ended.reason, ended.steps, wanted, list(map(str, errors)), codes)


def pulse_length(us: int) -> int:
    """The signed length of a pulse in microseconds, if the board can give it. Raises BadValue."""
    us = whole_number(us, _LONGEST_US, "a pulse in microseconds")
    if abs(us) < _SHORTEST_US:
        raise BadValue(f"a pulse has {_SHORTEST_US} microseconds or more, not {us}")
    return us


def _velocity_by_sight(pulse_us: int) -> float:
    """Steps per second, in hundredths, with _SIGHT_REST_US behind each pulse; no more than the board can do."""
    most = 100_000_000 // (pulse_us + _LEAST_REST_US)
    return min(100_000_000 // (pulse_us + _SIGHT_REST_US), most // 100 * 100 or most) / 100


def _split(steps: float, pulse_us: int) -> tuple[int, int]:
    """Whole steps and the length of one pulse (us) for the rest, both signed; a rest below the shortest pulse is 0."""
    sign = 1 if steps > 0 else -1
    n, part_us = divmod(round(abs(steps) * pulse_us), pulse_us)
    return sign * n, sign * part_us if part_us >= _SHORTEST_US else 0
