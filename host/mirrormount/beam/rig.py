"""A mount in front of a camera: moves, looks, and the mount's settings put back at the end. Imports mount, observer."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mirrormount.beam.observer import FRAMES, Observer, Sighting
from mirrormount.common.errors import MountError
from mirrormount.device.mount import Mount

Vector = NDArray[np.float64]  # (x, y) in px


class Rig(Protocol):
    """What an experiment needs. Moves return when the motors are at rest."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes that may be measured."""
        ...

    def step(self, axis: str, n: int) -> None: ...

    def pulse(self, axis: str, us: int) -> None: ...

    def look(self, frames: int = FRAMES) -> Sighting: ...

    def sleep(self, seconds: float) -> None: ...

    @property
    def picture_px(self) -> tuple[int, int]:
        """Width and height of the picture."""
        ...

    def step_us(self, axis: str) -> int:
        """The length of one step's pulse."""
        ...


@dataclass
class MountRig:
    """A mount and an observer. readings: the errors of all looks so far, for the reading's own scatter."""

    mount: Mount
    observer: Observer
    axes: tuple[str, ...] = ("x", "y")

    def step(self, axis: str, n: int) -> None:
        """Move by n steps. Raises as Axis.step()."""
        self.mount.axis(axis).step(n)

    def pulse(self, axis: str, us: int) -> None:
        """Give one pulse. Raises as Axis.pulse()."""
        self.mount.axis(axis).pulse(us)

    def look(self, frames: int = FRAMES) -> Sighting:
        """Where the spot is. Raises SpotLost, CameraError."""
        return self.observer.look(frames)

    def sleep(self, seconds: float) -> None:
        """Wait, on the mount's clock."""
        self.mount.sleep(seconds)

    @property
    def picture_px(self) -> tuple[int, int]:
        """Width and height of the picture."""
        return self.observer.camera.size.width, self.observer.camera.size.height

    def step_us(self, axis: str) -> int:
        """The length of one step's pulse."""
        return self.mount.axis(axis).ask_whole("XP?")[0]


@contextmanager
def borrowed(
    mount: Mount, wanted: Mapping[str, Mapping[str, int | float]], say: Callable[[str], object]
) -> Iterator[None]:
    """The mount with these settings; at the end, however it comes, motors off and the settings as they were.

    If they cannot be put back, say() is called with the line for the user.
    """
    before = mount.settings()
    try:
        mount.apply(wanted)
        yield
    finally:
        try:
            mount.stop()
            mount.apply(before)
        except MountError as e:
            say(f"the settings could not be put back ({e}): a restart of the board does that")


def place(sighting: Sighting) -> Vector:
    """A sighting as a vector."""
    return np.array([sighting.x, sighting.y])
