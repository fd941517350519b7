"""The interface of an open camera, and the frames that it returns. Imports no camera library.

A picture is an array of grey values of shape (rows, columns). A pixel's coordinates are x (column) and y (row), from
the centre of the top left pixel, x to the right and y down.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class Size(NamedTuple):
    """Size of a picture in pixels."""

    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.width} x {self.height}"


OF_DRIVER = "number of the driver"


class Controls(NamedTuple):
    """Whether the camera keeps exposure and gain: True (fixed), False (automatic), None (the camera does not say).

    exposure, gain: what they are, or were when the camera was opened if they are automatic; None: not known.
    exposure_unit: s, or OF_DRIVER, whose numbers mean something else with each driver, as those of every gain do.
    """

    exposure_fixed: bool | None
    gain_fixed: bool | None
    exposure: float | None = None
    exposure_unit: str | None = None
    gain: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One picture.

    image: uint8, (rows, columns), not to be written to.
    time_s: middle of the exposure on the camera's clock (Camera.monotonic), as well as it is known.
    number: counts the camera's frames from 0; a gap is frames that are known to be missing.
    repeated: the image is byte for byte that of the frame before, so it is no new measurement.
    late: the frame came later than two periods of the camera after the frame before.
    """

    image: "NDArray[np.uint8]"
    time_s: float
    number: int
    repeated: bool = False
    late: bool = False


class Camera(Protocol):
    """An open camera.

    name: identifies the camera in reports and in saved scales. size: of every frame.
    """

    @property
    def name(self) -> str: ...

    @property
    def size(self) -> Size: ...

    @property
    def controls(self) -> Controls: ...

    def frames(self) -> Iterator[Frame]:
        """Fresh frames, until a recording ends or for ever. Raises CameraError; the camera is then to be closed."""
        ...

    def monotonic(self) -> float:
        """The time of the clock that Frame.time_s is of, in seconds: the age of a frame is the difference."""
        ...

    def close(self) -> None:
        """Release the device; again without effect."""
        ...
