"""A mount in front of a camera: moves by sight, and observes the spot.

A move by sight is one without the board's take-up; the board's settings stay as they are, so however a measurement
ends, there is nothing to put back.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mirrormount.device.mount import Mount
from mirrormount_beam.observe import FRAMES, Sighting, SpotObserver

Vector = NDArray[np.float64]  # (x, y) in px
_SHORTEST_US, _LONGEST_US = 200, 2_000_000  # of the board's pulses


class Rig(Protocol):
    """What an experiment needs. Moves return when the motors are at rest; step() and pulse() take no backlash up."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes that may be measured."""
        ...

    def step(self, axis: str, n: int) -> None: ...

    def pulse(self, axis: str, us: int) -> None: ...

    def step_taken_up(self, axis: str, n: int, take_up_us: int) -> None:
        """Steps with the mount's own take-up; where that is off, with a pulse of take_up_us after a turn."""
        ...

    def take_up_us(self, axis: str) -> int:
        """The mount's own take-up; 0: off."""
        ...

    def observe(self, frames: int = FRAMES) -> Sighting: ...

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
    """A mount and an observer."""

    mount: Mount
    observer: SpotObserver
    axes: tuple[str, ...] = ("x", "y")
    _ways: dict[str, int] = field(default_factory=dict)  # of each axis's last move

    def step(self, axis: str, n: int) -> None:
        """Move by n steps. Raises as Axis.step()."""
        self.mount.axis(axis).step(n, by_sight=True)
        self._ways[axis] = 1 if n > 0 else -1

    def pulse(self, axis: str, us: int) -> None:
        """Give one pulse. Raises as Axis.pulse()."""
        self.mount.axis(axis).pulse(us, by_sight=True)
        self._ways[axis] = 1 if us > 0 else -1

    def step_taken_up(self, axis: str, n: int, take_up_us: int) -> None:
        """As Rig.step_taken_up(). A pulse is as long as the board can make it. Raises as Axis.step()."""
        if self.take_up_us(axis):
            self.mount.axis(axis).step(n)
            return
        way = 1 if n > 0 else -1
        if self._ways.get(axis) == -way and take_up_us >= _SHORTEST_US:
            self.pulse(axis, way * min(take_up_us, _LONGEST_US))
        self.step(axis, n)

    def take_up_us(self, axis: str) -> int:
        """The mount's own take-up; 0: off."""
        return self.mount.axis(axis).ask_whole("XB?")[0]

    def observe(self, frames: int = FRAMES) -> Sighting:
        """Where the spot is. Raises SpotLost, CameraError."""
        return self.observer.observe(frames)

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


def place(sighting: Sighting) -> Vector:
    """A sighting as a vector."""
    return np.array([sighting.x, sighting.y])
