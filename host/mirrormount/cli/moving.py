"""The work of step, move, home, jog and drive, on a mount that is open.

A motion is shown on one line while it lasts, if stderr is a terminal. However it ends, the position at the
end is printed; Ctrl-C stops both motors first.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence

from mirrormount.common.errors import REASONS, BadValue, MountError
from mirrormount.common.progress import StatusLine
from mirrormount.common.units import STEPS
from mirrormount.device.axis import Axis
from mirrormount.device.mount import AxisStatus, Mount
from mountfw import codes as wire

_LOOK_S = 0.05


def step(mount: Mount, name: str, amount: float, unit: str = STEPS) -> None:
    """Move by an amount of a unit and print the position."""
    axis = mount.axis(name)
    with watched(mount, [axis]) as line:
        aim = f"on the way to {axis.position + amount:+.1f}" if unit == STEPS else f"on the way by {amount:+g} {unit}"
        made = axis.move_by(amount, unit, progress=_shown(line, name, aim))
    print(place(axis) + (f" (moved by ≈ {made:+.4g} {unit})" if unit != STEPS else ""))


def move(mount: Mount, name: str, position: float, unit: str = STEPS) -> None:
    """Move to a position of a unit, which may lie between two steps, and print it."""
    axis = mount.axis(name)
    with watched(mount, [axis]) as line:
        words = f"{position:+g}" if unit == STEPS else f"{position:+g} {unit}"
        axis.move_to(position, unit, progress=_shown(line, name, f"on the way to {words}"))
    print(place(axis) + (f" (≈ {axis.position * axis.per_step(unit):+.4g} {unit})" if unit != STEPS else ""))


def home(mount: Mount, name: str) -> None:
    """Find the end-stop and print by how much the count was off."""
    axis = mount.axis(name)
    with watched(mount, [axis]) as line:
        off = axis.home(progress=_shown(line, name, "on the way to the end-stop")).discrepancy_steps
    print(f"{name}: at home" + ("" if off is None else f"; the count was off by {off:+.3f} steps"))


def jog(mount: Mount, name: str, speed: float, seconds: float | None) -> None:
    """Run one axis at a speed for some seconds, or until Ctrl-C or the board's run limit."""
    axis = mount.axis(name)
    _run(mount, [axis], seconds, lambda: axis.jog(speed))


def drive(mount: Mount, m1: int, m2: int, seconds: float | None) -> None:
    """Drive both motors for some seconds, or until Ctrl-C or the board's run limit."""
    if m1 == 0 and m2 == 0:
        mount.stop()
        return
    if mount.x.number > 2:
        mount.drive(m1, m2)  # raises NotSupported
    axes = [axis for axis in (mount.x, mount.y) if (m1, m2)[axis.number - 1]]
    _run(mount, axes, seconds, lambda: mount.drive(m1, m2))


def place(axis: Axis, status: AxisStatus | None = None) -> str:
    """Where an axis is: "x: +3.000 steps"."""
    return f"{axis.name}: {(status or axis.status()).position:+.3f} steps"


@contextlib.contextmanager
def watched(mount: Mount, axes: Sequence[Axis]) -> Iterator[StatusLine]:
    """A line to show a motion on. A KeyboardInterrupt stops both motors, and then says where the axes are."""
    line = StatusLine()
    try:
        yield line
    except KeyboardInterrupt:
        line.end()
        mount.stop()
        status = mount.status()
        places = [(axis, status.by_name[axis.name]) for axis in axes]
        where = ", ".join(f"{place(axis, at)} ({at.certainty})" for axis, at in places)
        raise KeyboardInterrupt(f"stopped at {where}") from None
    finally:
        line.end()


def _shown(line: StatusLine, name: str, where_to: str) -> Callable[[AxisStatus], None]:
    return lambda status: line.show(f"{name}: {status.position:+.1f} steps, {where_to}; Ctrl-C stops")


def _run(mount: Mount, axes: Sequence[Axis], seconds: float | None, start: Callable[[], None]) -> None:
    """Start a motion that has no end of its own, and wait until it ends."""
    limit_s = min(axis.run_limit_s for axis in axes)
    if seconds is not None and seconds > limit_s:
        name = next(axis.name for axis in axes if axis.run_limit_s == limit_s)
        raise BadValue(f"the board lets {name} run for {limit_s:g} s at most (setting {name}.run_limit_ms)")
    with watched(mount, axes) as line:
        start()
        ended = _watch_run(mount, axes, seconds, limit_s, line)
    print(", ".join(place(axis) for axis in axes) + ended)


def _watch_run(mount: Mount, axes: Sequence[Axis], seconds: float | None, limit_s: float, line: StatusLine) -> str:
    """Wait for the end of a run. Returns what is to be said of it; raises MoveEnded if something else ended it."""
    begun = mount.link.monotonic()
    end = math.inf if seconds is None else begun + seconds
    while (left := end - mount.link.monotonic()) > 0:
        mount.sleep(min(_LOOK_S, left))
        status = mount.status()
        if not status.moving:
            return _how_it_ended(mount, axes, limit_s)
        where = ", ".join(f"{axis.name}: {status.by_name[axis.name].position:+.1f} steps" for axis in axes)
        rest_s = min(end, begun + limit_s) - mount.link.monotonic()
        line.show(f"{where}; {max(0.0, rest_s):.0f} s more, Ctrl-C stops")
    mount.stop()
    return ""


def _how_it_ended(mount: Mount, axes: Sequence[Axis], limit_s: float) -> str:
    """The run limit is the bound that a run without --seconds was asked to end at; all else is an error."""
    reasons = [axis.last_move().reason for axis in axes]
    errors = mount.errors()
    if set(reasons) == {wire.RUN_LIMIT}:
        names = " and ".join(f"{axis.name}.run_limit_ms" for axis in axes)
        return f" (the run limit of {limit_s:g} s has ended it: setting {names})"
    whys = [f"{axis.name}: {REASONS.get(reason, reason)}" for axis, reason in zip(axes, reasons, strict=True)]
    ended = MountError(f"the motion ended early: {'; '.join([*whys, *map(str, errors)])}")
    ended.codes = tuple(error.code for error in errors)
    raise ended
