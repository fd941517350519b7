"""A camera with its target, as a loop needs it (loop_table.Eye). One that was unplugged is opened again."""

from collections.abc import Callable, Iterator

from mirrormount.beam import NoSpot, Spot, find_spot
from mirrormount.beam.camera import Camera, Frame, Size
from mirrormount.beam.picture import Dark
from mirrormount.common.beam_errors import CameraError, CameraGone, CameraSizeChanged
from mirrormount.common.errors import MountError


class CameraEye:
    """A camera of a table under its name there.

    um_per_px: of x and y. distance_m: from the last mirror along the beam, None where it is not known. reopen: opens
    the camera again after it has failed; None for one that comes back by itself.
    """

    def __init__(
        self,
        name: str,
        camera: Camera,
        target_px: tuple[float, float],
        um_per_px: tuple[float, float],
        distance_m: float | None,
        *,
        dark: Dark | None = None,
        reopen: Callable[[], Camera] | None = None,
    ) -> None:
        self.name = name
        self.target_px = target_px
        self.um_per_px = um_per_px
        self.distance_m = distance_m
        self.size: Size = camera.size
        self._camera = camera
        self._dark = dark
        self._reopen = reopen
        self._failed = False

    @property
    def camera(self) -> Camera:
        """The camera that is open now."""
        return self._camera

    def monotonic(self) -> float:
        """The clock of Frame.time_s, in seconds."""
        return self._camera.monotonic()

    def frames(self) -> Iterator[Frame]:
        """As Camera.frames(); after CameraError it may be called again. Raises CameraError while there is none."""
        try:
            if self._failed and self._reopen:
                self._camera.close()
                self._camera = _opened_again(self.name, self._reopen)
            if self._camera.size != self.size:
                raise CameraSizeChanged(f"{self.name}: the camera came back with {self._camera.size}, not {self.size}")
            self._failed = False
            yield from self._camera.frames()
        except CameraError:
            self._failed = True
            raise

    def find(self, frame: Frame) -> Spot | NoSpot:
        """The spot in a frame, or why there is none."""
        return find_spot(frame, self._dark)

    def close(self) -> None:
        """Release the camera."""
        self._camera.close()


def _opened_again(name: str, reopen: Callable[[], Camera]) -> Camera:
    """reopen(). Raises CameraError whatever stands in the way, such as a table.toml that somebody edits just now."""
    try:
        return reopen()
    except CameraError:
        raise
    except MountError as e:
        raise CameraGone(f"{name}: it is not opened again: {e}") from e
