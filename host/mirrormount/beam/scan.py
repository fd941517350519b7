"""Scans: a mount visits the places of a pattern, and a signal is read at each. Imports patterns, observer, mount.

    for sample in scan(mount, raster(9, 9), power):  # power(mount) returns a number
        print(sample.x, sample.y, sample.values)

The motors are off while a signal is read, between two samples, and after any end. A stop by any thread or by
`mirrormount stop` ends the scan.
"""

import contextlib
import math
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace

from mirrormount.beam.camera import Camera
from mirrormount.beam.observe import OF_MEASUREMENT, SpotObserver
from mirrormount.beam.patterns import Pattern, spiral
from mirrormount.common.beam_errors import SpotLost
from mirrormount.common.errors import MountError
from mirrormount.device.mount import Mount

_TRIES = 3  # frames in which a spot is looked for


class NoValue(Exception):
    """Raised by a signal that has no value at this place; the message says why."""


@dataclass(frozen=True, slots=True)
class Sample:
    """A measured place of a scan.

    time_s: since the scan began, on the mount's clock. x, y: steps from the start, as commanded. position_…,
    certainty_…: as the board says. values: those of Signal.columns; empty if there are none, and missing says why.
    """

    number: int
    time_s: float
    x: int
    y: int
    position_x: float
    certainty_x: str
    position_y: float
    certainty_y: str
    values: tuple[float, ...]
    missing: str = ""


@dataclass(frozen=True)
class Signal:
    """What is read at each place. columns: the unit of each value by its name. read: raises NoValue."""

    columns: Mapping[str, str]
    read: Callable[[Mount], Sequence[float]]

    @classmethod
    def of(cls, signal: "Signal | Callable[[Mount], float]") -> "Signal":
        """A signal; of a function the one that has what it returns as `value`."""
        if isinstance(signal, Signal):
            return signal
        return cls({"value": ""}, lambda mount: (signal(mount),))


def spot_signal(camera: Camera) -> Signal:
    """Place, its standard errors, and peak of the spot in a frame that is exposed when the mount has settled."""
    observer = SpotObserver(camera, patience=replace(OF_MEASUREMENT, missed=_TRIES, doubted=_TRIES))

    def read(_mount: Mount) -> tuple[float, ...]:
        try:
            seen = observer.observe(1)
        except SpotLost as e:
            raise NoValue(str(e)) from e
        return seen.x, seen.y, seen.error_x, seen.error_y, seen.peak

    return Signal({"spot_x": "px", "spot_y": "px", "error_x": "px", "error_y": "px", "peak": "grey"}, read)


def grey_signal(camera: Camera) -> Signal:
    """The mean grey value of a frame that is exposed when the mount has settled."""
    observer = SpotObserver(camera)
    return Signal({"grey": "grey"}, lambda _mount: (float(observer.settled().image.mean()),))


def scan(
    mount: Mount, pattern: Pattern, signal: Signal | Callable[[Mount], float], *, back: bool = False
) -> Generator[Sample, None, None]:
    """Visit the places of a pattern; a Sample of each that is measured, as soon as it is there.

    back: return to the start after the last one; not after an error or a stop. A value that is not finite is none.
    Raises MountError and what the signal raises, motors off. To end it early, close() the iterator.
    """
    signal = Signal.of(signal)
    begun_s, x, y, number = mount.link.monotonic(), 0, 0, 0
    try:
        with mount.unless_stopped():
            for place in pattern.places:
                _move(mount, place.x - x, place.y - y)
                x, y = place.x, place.y
                if place.measured:
                    values, missing = _read(signal, mount)
                    now = mount.status()
                    yield Sample(
                        number,
                        mount.link.monotonic() - begun_s,
                        x,
                        y,
                        now.x.position,
                        now.x.certainty,
                        now.y.position,
                        now.y.certainty,
                        values,
                        missing,
                    )
                    number += 1
            if back:
                _move(mount, -x, -y)
    except BaseException:
        with contextlib.suppress(MountError):  # the board's keep-alive stands behind it
            mount.stop()
        raise


@dataclass(frozen=True, slots=True)
class Found:
    """Where a search saw the beam, in steps from its start; after so many places."""

    x: int
    y: int
    places: int


def find(mount: Mount, see: Callable[[Mount], object], rings: int = 10, pitch: int = 1) -> Found | None:
    """Search the beam in a spiral and stay where see(mount) is true first; None, and back at the start, if nowhere.

    Raises as scan(), motors off.
    """
    samples = scan(mount, spiral(rings, pitch), lambda here: 1.0 if see(here) else 0.0, back=True)
    with contextlib.closing(samples):
        for sample in samples:
            if sample.values[0]:
                return Found(sample.x, sample.y, sample.number + 1)
    return None


def _move(mount: Mount, by_x: int, by_y: int) -> None:
    """One axis after the other; returns when both are at rest."""
    for axis, by in ((mount.x, by_x), (mount.y, by_y)):
        if by:
            axis.step(by)


def _read(signal: Signal, mount: Mount) -> tuple[tuple[float, ...], str]:
    """The values, or none and the reason."""
    try:
        values = tuple(float(value) for value in signal.read(mount))
    except NoValue as e:
        return (), str(e)
    for name, value in zip(signal.columns, values, strict=True):
        if not math.isfinite(value):
            return (), f"{name} is not finite: {value}"
    return values, ""
