"""The part of `mirrormount check` that moves the mirror: by a few steps, and about the same back."""

import math
from collections.abc import Callable, Iterator

from mirrormount.cli import self_test_encoder
from mirrormount.cli.outcomes import Wrong
from mirrormount.common.errors import REASONS, MoveEnded
from mirrormount.common.keep_alive import KEEP_ALIVE_MS
from mirrormount.device.mount import Axis, Ended, Mount
from mountfw import codes as wire

_KEEP_ALIVE_MS = 50
# less than the host's own keep-alive, which must not be the one that acts; and much more than this one, for on a busy
# computer a virtual board runs slower than the clock of its host
_SILENCE_S = 0.8 * KEEP_ALIVE_MS / 1000
_LATE_US = 1000  # what a pulse may be wrong by
_BY_ENCODER = (wire.CLOSED_LOOP_FAILED, wire.STALLED, wire.WRONG_WAY, wire.FOLLOWING, wire.ENCODER_LOST)
_WHY = "what its encoder counts has ended it, see there; docs/errors.md has the causes"


def checks(mount: Mount, axis: Axis) -> Iterator[tuple[str, Callable[[], str]]]:
    """The checks of one axis: (what, check)."""
    if axis.has_encoder:
        yield "encoder in a move", lambda: self_test_encoder.in_a_move(axis)
    yield "one step forward", lambda: one_step(axis, 1)
    yield "one step back", lambda: one_step(axis, -1)
    yield "stop in a move", lambda: stop(mount, axis)
    yield "keep-alive", lambda: keep_alive(mount, axis)


def one_step(axis: Axis, n: int) -> str:
    """A step is done, and its time under drive is the pulse's; a take-up of the backlash may come on top."""
    pulse_us, take_up_us = axis.ask_whole("XP?", "XB?")
    try:
        axis.step(n)
    except MoveEnded as e:
        if e.reason in _BY_ENCODER:
            raise Wrong(f"{e}: {_WHY}") from e
        raise
    if axis.has_encoder and axis.closed_loop:
        return f"done, {axis.last_move().on_time_s * 1e6:.0f} us under drive until its counts were there"
    on_us = round(axis.last_move().on_time_s * 1e6)
    if not pulse_us - _LATE_US <= on_us <= pulse_us + take_up_us + _LATE_US:
        raise Wrong(f"the motor had drive for {on_us} us, not {pulse_us} us: report it")
    return f"done, {on_us} us under drive for a pulse of {pulse_us} us"


def stop(mount: Mount, axis: Axis) -> str:
    """A stop ends a move that is under way."""
    _rest(mount, axis)
    axis.step(-_long_move(axis), wait=False)
    mount.link.sleep(0.05)
    mount.stop()
    _must_be(axis.wait(), wire.ABORTED)
    return "the move ended at once"


def keep_alive(mount: Mount, axis: Axis) -> str:
    """A move ends when its host falls silent, and the board says so."""
    _rest(mount, axis)
    mount.send(f"XK{_KEEP_ALIVE_MS};{axis.number}PR{_long_move(axis)}")
    mount.link.sleep(_SILENCE_S)
    _must_be(axis.wait(), wire.KEEP_ALIVE)
    codes = [error.code for error in mount.errors()]
    if wire.KEEP_ALIVE_LOST not in codes:
        raise Wrong(f"the move ended, but error {wire.KEEP_ALIVE_LOST} was not told: report it")
    return f"the move ended after {_KEEP_ALIVE_MS} ms of silence, and the board says {wire.KEEP_ALIVE_LOST}"


def _long_move(axis: Axis) -> int:
    """So many steps that the move lasts for a second at least, were it not ended."""
    pulse_us, velocity = axis.ask("XP?", "VA?")
    return math.ceil(1 / max(1 / float(velocity), int(pulse_us) * 1e-6)) + 1


def _rest(mount: Mount, axis: Axis) -> None:
    """Wait for the end of the last step's rest: a move that begins in it is ended before the motor has drive."""
    pulse_us, velocity = axis.ask("XP?", "VA?")
    mount.link.sleep(max(1 / float(velocity), int(pulse_us) * 1e-6) + 0.01)


def _must_be(ended: Ended, reason: int) -> None:
    if ended.reason in _BY_ENCODER:
        raise Wrong(f"the move ended as {REASONS[ended.reason]!r}: {_WHY}")
    if ended.reason != reason:
        raise Wrong(f"the move ended as {REASONS[ended.reason]!r}, not as {REASONS[reason]!r}: report it")
    if not ended.on_time_s:
        raise Wrong("the move ended before the motor had drive, so nothing was tested: run it again")
