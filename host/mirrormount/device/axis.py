"""`Axis`: moves, homing, limits, encoder and settings of one axis of a mount.

An Axis uses a Session, which keeps its motion alive and orders stops before starts. Positions are in steps. An
interrupt (Ctrl-C, or an interrupted cell of a notebook) of a method that waits for a motion stops all motors.

The settings of an axis are its properties. tools/tables.py writes them from the declarations of mountfw/settings.py, so
that editors and type checkers know each by its name.
"""

import contextlib
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Self, TypeVar, cast, overload

from mirrormount import values
from mirrormount.device import calibration, presets, settings
from mirrormount.device.session import Session
from mirrormount.device.status import AxisStatus, Ended, Homed, Limits, table
from mirrormount.errors import BadValue, BoardError, EncoderFault, MoveEnded, NoAnswer, NotAMount, NotSupported
from mirrormount.markup import html_text
from mirrormount.values import MOST_AMOUNT, jog_duty, positive_numbers, real_number, whole_number, whole_numbers
from mountfw import codes as wire
from mountfw.settings import MAX_STEPS

_log = logging.getLogger(__name__)

N = TypeVar("N", int, float)
Progress = Callable[[AxisStatus], None]  # called with each status during a wait

_POLL_S = 0.05  # between two questions whether a move is over
_SLACK_S = 4.0  # beyond the computed time of a move before it counts as stuck; 2 s of it for the backlash
_SIGHT_REST_US = 50_000  # after a pulse by sight: by then the motor has come to rest
_LEAST_REST_US = 1000  # the shortest rest that the board makes between two pulses
_SHORTEST_US, _LONGEST_US = 200, 2_000_000  # limits of a pulse of its own length (XU)
_SOFT_LIMITS_CHECKED = 8  # the bit of ZH

_WRAP = 1 << 20  # the board's counts wrap here
_APPROACH = 3  # steps that bring the gears to one side of their play, which an encoder behind them sees
_STEPS = 10  # steps whose counts are measured, each way
_LEAST = 4  # With fewer counts a step the board cannot close a loop.
_ALIKE = 0.4  # The counts of the two directions may differ by this part of the larger one.
_PLAY = 0.3  # A loss of less than this part of a step's counts is only the scatter of a timed step.
_COAST = 0.04  # The virtual bench's motor coasts by this part of a step's counts.
_SETTLED_S = 0.2  # after a move the motor has stopped coasting by then


class Property(Generic[N]):
    """A setting of an axis, read from the board and set on it. Its name is that of the setting.

    Reading raises BoardError, NoAnswer, ConnectionLost; setting also BadValue, SettingRefused.
    """

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, axis: None, owner: type) -> Self: ...
    @overload
    def __get__(self, axis: "Axis", owner: type) -> N: ...
    def __get__(self, axis: "Axis | None", owner: type) -> "Self | N":
        if axis is None:
            return self
        return cast(N, settings.read_one(axis._session, axis.name, self._name))

    def __set__(self, axis: "Axis", value: N) -> None:
        settings.write(axis._session, {axis.name: {self._name: value}})


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


class Axis:
    """One axis: x (right positive), y (up positive), axis3 … number: the board's.

    Its settings are properties; they last until the board restarts, unless saved.
    """

    __slots__ = ("_deadline", "_session", "name", "number")  # a misspelt setting raises AttributeError

    def __init__(self, session: Session, name: str, number: int) -> None:
        self._session = session
        self.name = name
        self.number = number
        self._deadline = 0.0  # by the link's clock: wait() takes a motion that lasts longer for stuck

    # properties: made by tools/tables.py
    inverted = Property[int]()
    """Wiring: 1: the axis runs the other way"""
    switches = Property[int]()
    """Wiring: switches fitted: 1 positive + 2 negative + 4 home"""
    motor_type = Property[int]()
    """Wiring: 3: DC motor connected, 0: none"""
    pulse_us = Property[int]()
    """Pulse and speed: length of a step's pulse, us"""
    step_duty = Property[int]()
    """Pulse and speed: duty of a step, 1 … 255"""
    velocity = Property[float]()
    """Pulse and speed: steps per second"""
    acceleration = Property[int]()
    """Pulse and speed: kept for other programs; pulses do not ramp"""
    run_duty = Property[int]()
    """Pulse and speed: duty of a run, 1 … 255"""
    start_duty = Property[int]()
    """Pulse and speed: least duty that starts the motor; 0: not measured"""
    pwm_hz = Property[int]()
    """Pulse and speed: PWM frequency, Hz; 0: the board file's"""
    slow_decay = Property[int]()
    """Pulse and speed: 1: slow decay, brakes in the PWM's pauses"""
    take_up_us = Property[int]()
    """Take-up: drive that takes up the backlash, us; 0: off"""
    checking = Property[int]()
    """Limits: 1 ignores end-stops + 8 checks soft limits"""
    soft_minimum = Property[int]()
    """Limits: negative soft limit, steps"""
    soft_maximum = Property[int]()
    """Limits: positive soft limit, steps"""
    run_limit_ms = Property[int]()
    """Limits: longest run, ms"""
    search_limit_ms = Property[int]()
    """Limits: longest search for a switch or an end, ms of drive"""
    counts_per_step = Property[int]()
    """Encoder: counts of one step; 0: not measured"""
    closed_loop = Property[int]()
    """Encoder: 1: closed loop, the position is measured; 0: open loop"""
    dead_band = Property[int]()
    """Encoder: counts that a move may end beside its target"""
    correction_s = Property[float]()
    """Encoder: rest before a move's end is judged, s"""
    following_error = Property[int]()
    """Encoder: counts that a step's drive may be wrong by"""
    stall_ms = Property[int]()
    """Encoder: drive without a count that ends a move, ms"""
    stall_duty = Property[int]()
    """Encoder: duty of a search for the end by stall; 0: off"""
    zero_angle = Property[int]()
    """Encoder: an AS5600's angle at position 0, 1 … 4096; 0: none"""
    # end

    def __repr__(self) -> str:
        """The last status; the board is not asked."""
        last = self._session.board.last
        shown = f"{last[1].by_name[self.name]}, {self._session.age()}" if last else "not seen yet"
        return f"<Axis {self.name}: {shown}>"

    def _repr_html_(self) -> str:
        last = self._session.board.last
        if not last:
            return html_text(repr(self))
        return table({self.name: last[1].by_name[self.name]}, self._session.age())

    # ---- state and queries

    @property
    def position(self) -> float:
        """The counted position, in steps; status() has its certainty."""
        return self.status().position

    def status(self) -> AxisStatus:
        """The state of this axis. Raises as Mount.status()."""
        return self._session.status().by_name[self.name]

    def ask(self, *queries: str) -> list[str]:
        """The answers to queries of this axis: axis.ask("XP?", "VA?"). Raises BoardError, NotAMount."""
        answers = self._session.send(";".join(f"{self.number}{query}" for query in queries)).split("; ")
        if len(answers) != len(queries):
            raise NotAMount(f"not the answers to {', '.join(queries)}: {'; '.join(answers)[:80]!r}")
        return answers

    def ask_whole(self, *queries: str) -> list[int]:
        """The same for queries whose answers are whole numbers."""
        return whole_numbers(",".join(self.ask(*queries)), len(queries))

    # ---- moves

    def step(
        self,
        n: int,
        *,
        wait: bool = True,
        feed: bool = True,
        by_sight: bool = False,
        approach: str | None = None,
        progress: Progress | None = None,
    ) -> None:
        """Move by n steps. With wait, returns when they are done, else at once.

        Without wait and feed the caller keeps the move alive, as in Mount.drive(). by_sight: without the board's
        take-up, and with rests of 50 ms, for a caller that sees what moves; the board's settings stay as they are.

        approach: "+" or "-", the direction of the last part of the way. The axis goes past the goal by more than the
        backlash and comes back where it must: two motions, and whatever ends the first one ends both.

        Raises BadValue, also for a place of an approach beyond a soft limit, BoardError if refused, MoveEnded if an
        end-stop, a limit or somebody else ended it, ConnectionLost, NoAnswer.
        """
        n = whole_number(n, MAX_STEPS, "steps")
        if approach is not None:
            _check_waits(None if wait and not by_sight else approach)
            stops = self._session.gate.last_stop()
            with self._session.stopped_by_interrupt():
                rest, _ = self._turn(n, 0, approach, feed, progress, stops)
                self._by(rest, 0, feed, progress, stops)
            return
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
        unit: str = values.STEPS,
        *,
        wait: bool = True,
        feed: bool = True,
        approach: str | None = None,
        progress: Progress | None = None,
    ) -> float:
        """Move to a position in one of values.UNITS, also between two steps. Returns the one reached, in steps.

        The remainder of whole steps is one pulse of its own length (`XU`), so that a whole position is reached
        also from one between two steps, such as a jog's end; the position is an estimate then. The board's shortest
        pulse is 200 us, 0.001 of a step of 200 ms: a smaller remainder stays.
        Angles and mm go by the mean scale of both directions, as positions are shown; NotCalibrated without one.
        Without wait the nearest whole number of steps is the target, which is returned, and steps must be whole. From
        between two steps the open loop ends up to half a step beside it; `position` tells. approach, and what is
        raised: as step() has it.
        """
        unit = values.check(unit)
        steps = self._steps_of(position, unit)
        if not wait:
            _check_waits(approach)
            target = whole_number(
                steps if unit == values.STEPS else round(steps), MAX_STEPS, "position, without waiting,"
            )
            self._move("PA", target, round(target - self.position), wait, feed, progress)
            return target
        wanted = real_number(steps, MAX_STEPS, "position")
        stops = self._session.gate.last_stop()
        n, part_us = self.parts_to(wanted)
        with self._session.stopped_by_interrupt():
            if approach is not None:
                n, part_us = self._turn(n, part_us, approach, feed, progress, stops)
            if isinstance(wanted, int) and not part_us:
                self._move("PA", wanted, n, wait, feed, progress, stops)
            else:
                self._by(n, part_us, feed, progress, stops)
        return self.position

    def move_by(
        self,
        amount: float,
        unit: str = values.STEPS,
        *,
        wait: bool = True,
        approach: str | None = None,
        progress: Progress | None = None,
    ) -> float:
        """Move by an amount of one of values.UNITS. Returns the amount that its pulses are worth.

        A part of a step is one pulse of its own length (`XU`) and makes the position an estimate; without wait, the
        nearest whole number of steps is moved, and an amount in steps must be whole. Angles and mm go by the scale of
        that direction in the calibration file (docs/calibration.md). approach: as step() has it. Raises NotCalibrated
        without a scale that belongs to the board's present step, BadFile, and as step() does.
        """
        unit = values.check(unit)
        amount = real_number(amount, MOST_AMOUNT, f"an amount in {unit}")
        if unit == values.STEPS and (not wait or isinstance(amount, int)):
            self.step(whole_number(amount, MAX_STEPS, "steps"), wait=wait, approach=approach, progress=progress)
            return amount
        stops = self._session.gate.last_stop()
        n, part_us, worth = self.parts_of(amount, unit, whole=not wait)
        if wait:
            with self._session.stopped_by_interrupt():
                if approach is not None:
                    n, part_us = self._turn(n, part_us, approach, True, progress, stops)
                self._by(n, part_us, True, progress, stops)
        else:
            _check_waits(approach)
            self._move("PR", n, n, wait, True, None, stops)
        return worth

    def parts_of(self, amount: float, unit: str = values.STEPS, *, whole: bool = False) -> tuple[int, int, float]:
        """How move_by() moves an amount: whole steps, the length of a pulse after them (us), what both are worth.

        whole: in whole steps, the nearest. Raises BadValue, NotCalibrated, BadFile, ConnectionLost, NoAnswer.
        """
        unit = values.check(unit)
        amount = real_number(amount, MOST_AMOUNT, f"an amount in {unit}")
        pulse_us, duty, inverted = self.ask_whole("XP?", "XD?", "XI?")
        per_step = 1.0 if unit == values.STEPS else self._per_step(unit, amount, (pulse_us, duty, inverted))
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
        unit = values.check(unit)
        if unit == values.STEPS:
            return 1.0
        pulse_us, duty, inverted = self.ask_whole("XP?", "XD?", "XI?")
        return sum(self._per_step(unit, way, (pulse_us, duty, inverted)) for way in (1, -1)) / 2

    def jog(self, speed: float, *, feed: bool = True) -> None:
        """Run at speed, -1 ... 1 of full duty and not 0, until stop(), a limit, or this program's end.

        The duty comes in steps of 1/255; the nearest is taken. Without feed the caller keeps it alive,
        as in Mount.drive().
        """
        duty = jog_duty(speed)
        a, session = self.number, self._session
        stops = session.gate.last_stop()
        if abs(duty) < (starts_at := self._starts_at()):
            _log.warning(
                "%s: a duty of %d is below %d, at which its motor starts (setting start_duty): it may not turn",
                *(self.name, abs(duty), starts_at),
            )
        if self.status().moving:  # the present move is superseded
            self.stop()
        run_duty, limit_ms = whole_numbers(session.ask(f"{a}XV?;{a}XM?"), 2, "; ")
        sign = "+" if duty > 0 else "-"
        with session.stopped_by_interrupt():
            # the stored run duty is put back in the same line
            session.start(f"{a}XV{abs(duty)};{a}MV{sign};{a}XV{run_duty}", stops)
            self.expect_end(limit_ms / 1000)
            if feed:
                session.keep_alive.start()

    def _starts_at(self) -> int:
        """The duty at which the motor starts; 0: not known."""
        try:
            return self.start_duty
        except BoardError as e:
            if e.code != wire.NO_SUCH_COMMAND:
                raise
            return 0  # an older firmware

    def stop(self) -> None:
        """End this axis's move soon: a step that is nearly done is finished. Mount.stop() is immediate."""
        self._session.ask(f"{self.number}ST;{self.number}MD?")
        self.wait()

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

    def _steps_of(self, position: float, unit: str) -> float:
        if unit == values.STEPS:
            return position
        amount = real_number(position, MOST_AMOUNT, f"a position in {unit}")
        return real_number(amount / self.per_step(unit), MAX_STEPS, f"{amount:g} {unit} in steps")

    def _per_step(self, unit: str, amount: float, step: tuple[int, int, int]) -> float:
        """How much of a unit one step in the direction of amount is."""
        made = calibration.Step(*step)
        scale, mirror_mrad = calibration.scale_of(
            self._session.board.id, self.number, self.name, 1 if amount > 0 else -1, made, self._own_scale(made)
        )
        return values.per_step(scale, mirror_mrad, unit, self.name)

    def _own_scale(self, step: calibration.Step) -> calibration.Scale | None:
        """The scale that a virtual mount in this process brings; None of another one."""
        simulation = getattr(self._session.link.port, "simulation", None)
        return simulation.scale(self.number, step) if simulation else None

    @property
    def scale_source(self) -> str:
        """Whose scale angles go by, for a text: "" that of the calibration file. Raises BadFile."""
        if not hasattr(self._session.link.port, "simulation"):
            return ""
        return "" if calibration.read(self._session.board.id, self.number) else "by the virtual mount's own scale"

    def _by(self, n: int, part_us: int, feed: bool, progress: Progress | None, stops: int) -> None:
        """Move by n steps and one pulse of part_us, both signed, and wait."""
        if n:
            self._move("PR", n, n, True, feed, progress, stops)
        if part_us:
            self._move("XU", part_us, 1, True, feed, progress, stops)

    def _turn(
        self, n: int, part_us: int, approach: str, feed: bool, progress: Progress | None, stops: int
    ) -> tuple[int, int]:
        """Go to where the last part of a way begins. Returns that part: whole steps and a pulse, both of one sign.

        That part is longer than the backlash, also where the whole way goes in its direction: the shaft may stand at
        the other side of its gap. Raises BadValue before any motion if a soft limit forbids a place of it.
        """
        if approach not in ("+", "-"):
            raise BadValue(f'an approach is "+" or "-", not {approach!r}')
        pulse_us, take_up_us = self.ask_whole("XP?", "XB?")
        sign = 1 if approach == "+" else -1
        way = sign * (n + part_us / pulse_us)
        last = max(_APPROACH, take_up_us // pulse_us + 2)
        first = math.floor(way - last)
        begin, limits = self.position, self.limits
        for what, steps in (("turns at", begin + sign * first), ("ends at", begin + sign * way)):
            if limits.checked and not limits.minimum <= steps <= limits.maximum:
                within = f"{limits.minimum} to {limits.maximum}"
                raise BadValue(f"{self.name}: this approach {what} {steps:+.3f} steps; the soft limits are {within}")
        if first:
            self._by(sign * first, 0, feed, progress, stops)
        return _split(sign * (way - first), pulse_us)

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
        pulse_us, velocity = positive_numbers(session.ask(f"{a}XP?;{a}VA?"), 2)
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

    def _wait_until_done(self, wanted: int | None, progress: Progress | None = None) -> None:
        ended = self.wait(progress)
        if ended.reason != wire.DONE:
            errors = self._session.errors()
            codes = tuple(error.code for error in errors)
            raise MoveEnded(self.name, ended.reason, ended.steps, wanted, list(map(str, errors)), codes)

    # ---- homing and limits

    def zero(self, steps: int = 0) -> bool:
        """Define the present position as `steps`; from here on it is counted. Raises BadValue as step() does.

        The position before is kept on this computer: mount.presets.undo_zero(). Returns whether that could be done.
        """
        before = self._session.status()
        self.define(steps)
        was = before.by_name[self.name]
        entry = {"axis": self.number, "from": was.position, "to": steps, "certainty": was.certainty}
        return presets.remember(self._session.board.id, f"zero {self.number}", entry | {"boot_id": before.boot_id})

    def define(self, steps: int) -> None:
        """zero(), of which nothing is kept. Raises as zero()."""
        steps = whole_number(steps, MAX_STEPS, "position")
        log = self._session.motion_log
        with log.setting(self.number) if log else contextlib.nullcontext():
            self._session.send(f"{self.number}DH{steps}")
            self._session.status()

    def home(self, progress: Progress | None = None) -> Homed:
        """Find the home switch (or the end-stop that stands in for it); position 0 is there. Returns when done.

        Raises BoardError (n35: no switch fitted), MoveEnded (n45: switch not found, n46: it did not
        release, n04 or n05: the other end's switch came first), ConnectionLost, NoAnswer.
        """
        with self._session.stopped_by_interrupt():
            self.start_homing()
            self._wait_until_done(None, progress)
        known, millisteps = whole_numbers(self.ask("OR?")[0], 2)
        return Homed(millisteps / 1000 if known else None)

    def start_homing(self) -> None:
        """Start homing and return; the caller keeps it alive, as in Mount.drive(). Raises BoardError."""
        log = self._session.motion_log
        with log.homing(self.number) if log else contextlib.nullcontext():
            self._seek("OR")
        presets.remember(self._session.board.id, f"homed {self.number}", "")

    def find_end_stop(self, direction: int) -> None:
        """Go to the end-stop in direction 1 or -1, and stand at it. Raises as home() does."""
        if isinstance(direction, bool) or direction not in (1, -1):
            raise BadValue(f"an end-stop's direction is 1 or -1, not {direction!r}")
        with self._session.stopped_by_interrupt():
            self._seek("MT+" if direction > 0 else "MT-")
            self._wait_until_done(None)

    @property
    def limits(self) -> Limits:
        """The soft limits, in steps. Settable; raises BadValue if the minimum is above the maximum."""
        low, high, checking = self.ask_whole("SL?", "SR?", "ZH?")
        return Limits(low, high, bool(checking & _SOFT_LIMITS_CHECKED))

    @limits.setter
    def limits(self, limits: Limits) -> None:
        if not isinstance(limits, Limits):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise BadValue(f"soft limits are Limits(minimum, maximum), not {limits!r}")
        if limits.minimum > limits.maximum:
            raise BadValue(
                f"a soft minimum of {limits.minimum} above the maximum of {limits.maximum} forbids everything"
            )
        checking = self.ask_whole("ZH?")[0] & ~_SOFT_LIMITS_CHECKED
        wanted = {
            "soft_minimum": limits.minimum,
            "soft_maximum": limits.maximum,
            "checking": checking | (_SOFT_LIMITS_CHECKED if limits.checked else 0),
        }
        settings.write(self._session, {self.name: wanted})

    @property
    def run_limit_s(self) -> float:
        """How long the board lets one jog or drive run, in seconds (`XM`)."""
        return whole_numbers(self._session.ask(f"{self.number}XM?"), 1)[0] / 1000

    def _seek(self, command: str) -> None:
        """Start a search for a switch. The search limit bounds the drive time; slow pulses have rests between them."""
        session = self._session
        stops = session.gate.last_stop()
        limit_ms, pulse_us = self.ask_whole("XT?", "XP?")
        slow_us = max(pulse_us // 8, 200)  # a pulse of the search
        longest_s = limit_ms / 1000 * (1 + max(slow_us, 20_000) / slow_us)
        session.start(f"{self.number}{command}", stops)
        self.expect_end(longest_s)

    # ---- encoder

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
        was = {"closed_loop": before["closed_loop"]} if "closed_loop" in before else {}
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


def pulse_length(us: int) -> int:
    """The signed length of a pulse in microseconds, if the board can give it. Raises BadValue."""
    us = whole_number(us, _LONGEST_US, "a pulse in microseconds")
    if abs(us) < _SHORTEST_US:
        raise BadValue(f"a pulse has {_SHORTEST_US} microseconds or more, not {us}")
    return us


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


def _velocity_by_sight(pulse_us: int) -> float:
    """Steps per second, in hundredths, with _SIGHT_REST_US behind each pulse; no more than the board can do."""
    most = 100_000_000 // (pulse_us + _LEAST_REST_US)
    return min(100_000_000 // (pulse_us + _SIGHT_REST_US), most // 100 * 100 or most) / 100


def _check_waits(approach: str | None) -> None:
    if approach is not None:
        raise BadValue("an approach is two motions: it waits for them, and is not by sight")


def _split(steps: float, pulse_us: int) -> tuple[int, int]:
    """Whole steps and the length of one pulse (us) for the rest, both signed; a rest below the shortest pulse is 0."""
    sign = 1 if steps > 0 else -1
    n, part_us = divmod(round(abs(steps) * pulse_us), pulse_us)
    return sign * n, sign * part_us if part_us >= _SHORTEST_US else 0
