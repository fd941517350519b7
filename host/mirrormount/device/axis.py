"""One axis of a mount: steps, moves, jogs, homing. Imports calibration, errors, session, settings, status, validation.

An Axis uses a Session, which keeps its motion alive and orders stops before starts. An interrupt (Ctrl-C, or an
interrupted cell of a notebook) of a method that waits for a motion stops all motors.
"""

import html
from collections.abc import Callable

from mirrormount.common.errors import BadValue, MoveEnded, NoAnswer, NotAMount
from mirrormount.common.validation import positive_numbers, real_number, whole_number, whole_numbers
from mirrormount.device import settings
from mirrormount.device.session import Session
from mirrormount.device.status import AxisStatus, Ended, Homed, Limits, table
from mountfw import codes as wire

Progress = Callable[[AxisStatus], None]  # called with each status during a wait

_POLL_S = 0.05
_SLACK_S = 4.0  # beyond the computed time of a move before it counts as stuck; 2 s of it for the backlash
_SHORTEST_US = 200  # pulse of the board (XU)
_SOFT_LIMITS_CHECKED = 8  # the bit of ZH


class Axis:
    """One axis: x (right positive), y (up positive), axis3 … number: the board's."""

    __slots__ = ("_deadline", "_session", "name", "number")  # assigning any other name raises AttributeError

    def __init__(self, session: Session, name: str, number: int) -> None:
        self._session = session
        self.name = name
        self.number = number
        self._deadline = 0.0

    def __repr__(self) -> str:
        """The last status; the board is not asked."""
        last = self._session.board.last
        shown = f"{last[1].by_name[self.name]}, {self._session.age()}" if last else "not seen yet"
        return f"<Axis {self.name}: {shown}>"

    def _repr_html_(self) -> str:
        last = self._session.board.last
        if not last:
            return html.escape(repr(self))
        return table({self.name: last[1].by_name[self.name]}, self._session.age())

    @property
    def position(self) -> float:
        """The counted position, in steps; status() has its certainty."""
        return self.status().position

    def status(self) -> AxisStatus:
        """The state of this axis. Raises as Mount.status()."""
        return self._session.status().by_name[self.name]

    def step(self, n: int, *, wait: bool = True, feed: bool = True, progress: Progress | None = None) -> None:
        """Move by n steps. With wait, returns when they are done, else at once.

        Without wait and feed the caller keeps the move alive, as in Mount.drive().

        Raises BadValue, BoardError if refused, MoveEnded if an end-stop, a limit or somebody else
        ended it, ConnectionLost, NoAnswer.
        """
        n = whole_number(n, 1_000_000, "steps")
        self._move("PR", n, n, wait, feed, progress)

    def move_to(self, steps: float, *, wait: bool = True, feed: bool = True, progress: Progress | None = None) -> float:
        """Move to the position `steps`, which may lie between two steps. Returns the position that is reached.

        The remainder of whole steps is one pulse of its own length (`XU`), so that a whole position is reached
        also from one between two steps, such as a jog's end; the position is an estimate then. The board's shortest
        pulse is 200 us, 0.001 of a step of 200 ms: a smaller remainder stays.
        Without wait the nearest whole number of steps is moved to, and `steps` must be whole. Raises as step() does.
        """
        if not wait:
            target = whole_number(steps, 1_000_000, "position, without waiting,")
            self._move("PA", target, round(target - self.position), wait, feed, progress)
            return target
        wanted = real_number(steps, 1_000_000, "position")
        stops = self._session.gate.last_stop()
        (pulse_us,) = self.ask_whole("XP?")
        left = round(wanted * 1000) - round(self.position * 1000)  # thousandths of a step
        n, part = divmod(abs(left), 1000)
        part_us = round(part * pulse_us / 1000)
        if part_us < _SHORTEST_US:
            part_us = 0
        sign = 1 if left > 0 else -1
        with self._session.stopped_by_interrupt():
            if isinstance(wanted, int) and not part_us:
                self._move("PA", wanted, n, wait, feed, progress, stops)
            elif n:
                self._move("PR", sign * n, n, wait, feed, progress, stops)
            if part_us:
                self._move("XU", sign * part_us, 1, wait, feed, progress, stops)
        return self.position

    def zero(self, steps: int = 0) -> None:
        """Define the present position as `steps`; from here on it is counted."""
        self._session.send(f"{self.number}DH{whole_number(steps, 1_000_000, 'position')}")

    def move_by(self, amount: float, unit: str = "steps", *, wait: bool = True) -> float:
        """Move by an amount of steps, of mrad or of urad; the angle is the mirror's. Returns the amount moved.

        An angle becomes the nearest whole number of steps, by the scale of that direction in the
        calibration file (docs/calibration.md). Raises NotCalibrated without one that belongs to the
        board's present step, BadFile, and as step() does.
        """
        if unit == "steps":
            self.step(amount, wait=wait)  # type: ignore[arg-type]  # refused there if it is not whole
            return amount
        per_mrad = {"mrad": 1.0, "urad": 1000.0}.get(unit)
        if per_mrad is None:
            raise BadValue(f"a unit is steps, mrad or urad, not {unit!r}")
        if isinstance(amount, bool) or not isinstance(amount, int | float) or not abs(amount) < 1e9:
            raise BadValue(f"an angle is a number, not {amount!r}")
        mrad_per_step = self._scale(1 if amount > 0 else -1)
        n = round(amount / per_mrad / mrad_per_step)
        if n == 0 and amount:
            raise BadValue(f"{amount:g} {unit} is less than half a step of {mrad_per_step * per_mrad:.3g} {unit}")
        self.step(n, wait=wait)
        return n * mrad_per_step * per_mrad

    def ask(self, *queries: str) -> list[str]:
        """The answers to queries of this axis: axis.ask("XP?", "VA?"). Raises BoardError, NotAMount."""
        answers = self._session.send(";".join(f"{self.number}{query}" for query in queries)).split("; ")
        if len(answers) != len(queries):
            raise NotAMount(f"not the answers to {', '.join(queries)}: {'; '.join(answers)[:80]!r}")
        return answers

    def ask_whole(self, *queries: str) -> list[int]:
        """The same for queries whose answers are whole numbers."""
        return whole_numbers(",".join(self.ask(*queries)), len(queries))

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
        self._seek("OR")

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
    def take_up_us(self) -> int:
        """Drive in microseconds that takes up the backlash after a reversal; 0 is off. Settable."""
        return self.ask_whole("XB?")[0]

    @take_up_us.setter
    def take_up_us(self, us: int) -> None:
        settings.write(self._session, {self.name: {"take_up_us": us}})

    @property
    def run_limit_s(self) -> float:
        """How long the board lets one jog or drive run, in seconds (`XM`)."""
        return whole_numbers(self._session.ask(f"{self.number}XM?"), 1)[0] / 1000

    def jog(self, speed: float, *, feed: bool = True) -> None:
        """Run at speed, -1 ... 1 of full duty and not 0, until stop(), a limit, or this program's end.

        The duty comes in steps of 1/255; the nearest is taken. Without feed the caller keeps it alive,
        as in Mount.drive().
        """
        if isinstance(speed, bool) or not isinstance(speed, int | float) or not 0 < abs(speed) <= 1:
            raise BadValue(f"a jog's speed is a number within -1 … 1 other than 0, not {speed!r}")
        duty = round(abs(speed) * 255)
        if duty == 0:
            raise BadValue(f"a jog's speed comes in steps of 1/255: {speed!r} is none")
        a, session = self.number, self._session
        stops = session.gate.last_stop()
        if self.status().moving:  # the present move is superseded
            self.stop()
        run_duty, limit_ms = whole_numbers(session.ask(f"{a}XV?;{a}XM?"), 2, "; ")
        sign = "+" if speed > 0 else "-"
        with session.stopped_by_interrupt():
            # the stored run duty is put back in the same line
            session.start(f"{a}XV{duty};{a}MV{sign};{a}XV{run_duty}", stops)
            self.expect_end(limit_ms / 1000)
            if feed:
                session.keep_alive.start()

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

    def _scale(self, direction: int) -> float:
        """mrad of the mirror a step, in that direction."""
        from mirrormount.device import calibration  # a program that stops, or counts in steps, needs no file

        step = calibration.Step(*self.ask_whole("XP?", "XD?", "XI?"))
        return calibration.mrad_per_step(self._session.board.id, self.number, self.name, direction, step)

    def _move(
        self,
        mnemonic: str,
        value: int,
        n: int,
        wait: bool,
        feed: bool,
        progress: Progress | None = None,
        stops: int | None = None,
    ) -> None:
        """Start a move of n steps. stops: gate.last_stop() at the request, None: now."""
        a, session = self.number, self._session
        stops = session.gate.last_stop() if stops is None else stops
        pulse_us, velocity = positive_numbers(session.ask(f"{a}XP?;{a}VA?"), 2)
        period_s = max(1 / velocity, pulse_us * 1e-6 + 1e-3)
        with session.stopped_by_interrupt():
            session.start(f"{a}{mnemonic}{value}", stops)
            self.expect_end((abs(n) + 1) * period_s)
            if wait:
                self._wait_until_done(n, progress)
            elif feed:
                session.keep_alive.start()

    def _seek(self, command: str) -> None:
        """Start a search for a switch. The search limit bounds the drive time; slow pulses have rests between them."""
        session = self._session
        stops = session.gate.last_stop()
        limit_ms, pulse_us = self.ask_whole("XT?", "XP?")
        slow_us = max(pulse_us // 8, 200)  # a pulse of the search
        longest_s = limit_ms / 1000 * (1 + max(slow_us, 20_000) / slow_us)
        session.start(f"{self.number}{command}", stops)
        self.expect_end(longest_s)

    def _wait_until_done(self, wanted: int | None, progress: Progress | None = None) -> None:
        ended = self.wait(progress)
        if ended.reason != wire.DONE:
            errors = self._session.errors()
            codes = tuple(error.code for error in errors)
            raise MoveEnded(self.name, ended.reason, ended.steps, wanted, list(map(str, errors)), codes)
