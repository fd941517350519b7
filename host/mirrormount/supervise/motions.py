"""Motions on the mount: how each request is started, and the outcome of those that a program awaits."""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from dataclasses import dataclass, replace

from mirrormount.device.mount import Mount
from mirrormount.device.status import Ended, QueuedError, Status
from mirrormount.errors import MountError, MoveEnded
from mirrormount.supervise.connection import State
from mirrormount.supervise.lease import Client
from mirrormount.supervise.requests import (
    MOST_STEPS,
    Drive,
    GoTo,
    Home,
    Jog,
    MoveBy,
    MoveTo,
    Pulse,
    Request,
    Steps,
    Zero,
)
from mirrormount.values import real_number
from mountfw import codes as wire

_WHOLE = (wire.DONE,)
_JOG_ENDS = (wire.DONE, wire.STOPPED)  # a jog that was ended as its client asked


class Motion:
    """A requested motion of one axis. Its outcome: how it ended, or why it was not made.

    future: the outcome, for asyncio.wrap_future() or add_done_callback(); a client that awaits it there goes on
    with its own beats.
    """

    def __init__(self, axis: str, wanted: int | None, beat: Callable[[], None], every_s: float, *, jog: bool) -> None:
        self.axis = axis
        self.future: Future[Ended] = Future()
        self._wanted = wanted
        self._beat = beat
        self._every_s = every_s
        self._normal = _JOG_ENDS if jog else _WHOLE

    def __repr__(self) -> str:
        """Axis and state."""
        return f"<Motion {self.axis}: {'over' if self.future.done() else 'not over'}>"

    @property
    def done(self) -> bool:
        """True if the outcome is known."""
        return self.future.done()

    def wait(self, timeout_s: float | None = None) -> Ended:
        """Wait for the outcome; the client beats meanwhile.

        Raises MoveEnded (it ended before it was done, or was stopped before it began), BoardError (refused),
        NotInControl, NoAnswer, ConnectionLost, or TimeoutError after timeout_s: then it goes on.
        """
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            self._beat()
            left_s = self._every_s if end_s is None else min(self._every_s, end_s - time.monotonic())
            try:
                return self.future.result(max(left_s, 0.0))
            except TimeoutError:
                if end_s is not None and time.monotonic() >= end_s:
                    raise TimeoutError(f"{self.axis}: not over within {timeout_s:g} s") from None

    def fail(self, why: Exception) -> None:
        """It was not made, or nothing is known of its end."""
        with suppress(InvalidStateError):
            self.future.set_exception(why)

    def end(self, ended: Ended, errors: Sequence[QueuedError] = ()) -> None:
        """It was begun, and is over."""
        if ended.reason in self._normal:
            with suppress(InvalidStateError):
                self.future.set_result(ended)
        else:
            codes = tuple(error.code for error in errors)
            self.fail(MoveEnded(self.axis, ended.reason, ended.steps, self._wanted, list(map(str, errors)), codes))


@dataclass(eq=False)
class Asked:
    """A request that waits. stops: how many stops had been requested by then. motion: its outcome is awaited.

    rest: what is begun when the request is done, for the part of a step. made: steps of the first part, if this is a
    rest. superseded: a later request waits for its end.
    """

    client: Client
    request: Request
    stops: int
    at_s: float
    motion: Motion | None = None
    rest: Pulse | None = None
    made: int = 0
    superseded: bool = False

    def refuse(self, why: MountError) -> None:
        """Tell the client that it is not carried out."""
        if self.motion:
            self.motion.fail(why)
        else:
            self.client.notices.append(str(why))

    def drop(self, why: MountError | None = None) -> None:
        """A stop has overtaken it: only who awaits its outcome is told."""
        if self.motion:
            stopped = MoveEnded(self.motion.axis, wire.ABORTED, 0, None, ["stopped before it began"])
            self.motion.fail(why or stopped)

    def end(self, reason: int) -> None:
        """A later order has come before it began."""
        _end(self, Ended(reason, self.made, 0.0))


# A program's request of this kind replaces the motion that is under way; any other is refused by the board meanwhile.
REPLACING = (GoTo, MoveTo, Jog, Home)


class Motions:
    """The motions that were begun and are awaited, or have a rest; at most one an axis. For the worker's thread.

    begin_rest(axis, asked): called with the rest of a request when its first part was done, with the time by the clock.
    """

    def __init__(self, clock: Callable[[], float], begin_rest: Callable[[str, Asked], object]) -> None:
        self._begun: dict[str, Asked] = {}
        self._clock = clock
        self._begin_rest = begin_rest

    def __contains__(self, axis: str) -> bool:
        """True while a motion of this axis is under way."""
        return axis in self._begun

    def supersede(self, axis: str) -> bool:
        """The motion of this axis is to be halted for a later one. True if it was not before."""
        before, self._begun[axis].superseded = self._begun[axis].superseded, True
        return not before

    def begin(self, asked: Asked) -> None:
        """This request was begun: it supersedes a motion of the same axis."""
        axis = getattr(asked.request, "axis", None)
        for name in [name for name in self._begun if axis in (None, name)]:
            _end(self._begun.pop(name), Ended(wire.SUPERSEDED, 0, 0.0))
        if axis and (asked.motion or asked.rest):
            self._begun[axis] = asked

    def poll(self, mount: Mount, status: Status, errors: Sequence[QueuedError]) -> None:
        """End those whose axes are at rest. Raises ConnectionLost, NoAnswer."""
        for axis in [axis for axis in self._begun if not status.by_name[axis].moving]:
            ended, asked = mount.axis(axis).last_move(), self._begun.pop(axis)
            if asked.superseded and (ended.reason == wire.STOPPED or (asked.rest and ended.reason == wire.DONE)):
                _end(asked, replace(ended, reason=wire.SUPERSEDED), errors)
            elif asked.rest and ended.reason == wire.DONE:
                rest = replace(asked, request=asked.rest, rest=None, made=ended.steps, at_s=self._clock())
                self._begin_rest(axis, rest)
            else:
                _end(asked, ended, errors)

    def fail(self, why: MountError) -> None:
        """The board has gone: nothing is known of their ends."""
        while self._begun:
            motion = self._begun.popitem()[1].motion
            if motion:
                motion.fail(why)


def _end(asked: Asked, ended: Ended, errors: Sequence[QueuedError] = ()) -> None:
    if asked.motion:
        asked.motion.end(ended, errors)


def start(mount: Mount, asked: Asked, state: State) -> None:
    """Start a motion, and note its rest and the targets of its axes. Raises MountError."""
    targets = state.targets
    match asked.request:
        case Steps(axis, n, by_sight):
            targets[axis] = None
            mount.axis(axis).step(n, wait=False, feed=False, by_sight=by_sight)
        case Pulse(axis, us, by_sight):
            targets[axis] = None
            mount.axis(axis).pulse(us, wait=False, feed=False, by_sight=by_sight)
        case GoTo(axis, position):
            motor = mount.axis(axis)
            n, part_us = (0, 0) if asked.motion else motor.parts_to(position)  # a program's ends as whole steps do
            if part_us:
                asked.rest = _start_parts(mount, axis, n, part_us)
            else:
                motor.move_to(position, wait=False, feed=False)
            targets[axis] = position
        case MoveBy(axis, amount, unit):
            targets[axis] = None
            n, part_us, _ = mount.axis(axis).parts_of(amount, unit)
            asked.rest = _start_parts(mount, axis, n, part_us)
        case MoveTo(axis, position, unit, parts):
            motor = mount.axis(axis)
            steps = real_number(position / motor.per_step(unit), MOST_STEPS, f"{position:g} {unit} in steps")
            if parts:
                asked.rest = _start_parts(mount, axis, *motor.parts_to(steps))
            else:
                steps = round(steps)
                motor.move_to(steps, wait=False, feed=False)
            targets[axis] = round(steps, 3)
        case Jog(axis, speed):
            targets[axis] = None
            mount.axis(axis).jog(speed, feed=False)
        case Drive(x, y):
            targets.clear()
            duty = {mount.x.number: x, mount.y.number: y}
            mount.drive(duty.get(1, 0), duty.get(2, 0), feed=False)  # raises NotSupported for axes 3 and 4
        case Home(axis):
            targets[axis] = None
            mount.axis(axis).start_homing()
        case Zero(axis):
            targets[axis] = None
            mount.axis(axis).zero()
        case other:
            raise TypeError(f"not started here: {other!r}")
    if not isinstance(asked.request, Zero):
        state.began(getattr(asked.request, "axis", None))


def _start_parts(mount: Mount, axis: str, n: int, part_us: int) -> Pulse | None:
    """Start n whole steps, or else the pulse of part_us (us). Returns what is left for later."""
    motor = mount.axis(axis)
    if part_us and not n:
        motor.pulse(part_us, wait=False, feed=False)
        return None
    motor.step(n, wait=False, feed=False)
    return Pulse(axis, part_us) if part_us else None
