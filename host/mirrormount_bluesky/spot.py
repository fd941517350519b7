"""The spot of a laser in a camera's images, as Bluesky triggers and reads it."""

import asyncio
import math
from concurrent.futures import ThreadPoolExecutor

from bluesky.protocols import Triggerable
from ophyd_async.core import AsyncStatus, StandardReadable, StandardReadableFormat, soft_signal_r_and_setter

from mirrormount_beam.observe import FRAMES, Fault, FrameSource, SpotObserver

_PX = "px"


class CameraSpot(StandardReadable, Triggerable):
    """The mean place in images that are exposed after the trigger, when the mount has settled.

    x, y: px from the centre of the top left one, x to the right, y down. sigma_x, sigma_y: their standard errors.
    width, height: standard deviations of the beam; shape: the doubt that its shape leaves, px (find.Spot). found: 0 if
    there is no spot; the others are nan then. A trigger fails if the camera does.
    """

    def __init__(self, camera: FrameSource, name: str = "", *, frames: int = FRAMES) -> None:
        self._observer = SpotObserver(camera)
        self._frames = frames
        self._thread = ThreadPoolExecutor(1, "spot")  # one, so that a trigger waits for one that was given up
        with self.add_children_as_readables(StandardReadableFormat.HINTED_SIGNAL):
            self.x, self._set_x = soft_signal_r_and_setter(float, math.nan, units=_PX, precision=2)
            self.y, self._set_y = soft_signal_r_and_setter(float, math.nan, units=_PX, precision=2)
        with self.add_children_as_readables():
            self.sigma_x, self._set_sigma_x = soft_signal_r_and_setter(float, math.nan, units=_PX, precision=3)
            self.sigma_y, self._set_sigma_y = soft_signal_r_and_setter(float, math.nan, units=_PX, precision=3)
            self.width, self._set_width = soft_signal_r_and_setter(float, math.nan, units=_PX, precision=2)
            self.height, self._set_height = soft_signal_r_and_setter(float, math.nan, units=_PX, precision=2)
            self.shape, self._set_shape = soft_signal_r_and_setter(float, math.nan, units=_PX, precision=2)
            self.found, self._set_found = soft_signal_r_and_setter(int, 0)
        super().__init__(name)

    @AsyncStatus.wrap
    async def trigger(self) -> None:
        """Look. Raises CameraError."""
        found, *numbers = await asyncio.get_running_loop().run_in_executor(self._thread, self._look)
        self._set_found(int(found))
        setters = (self._set_x, self._set_y, self._set_sigma_x, self._set_sigma_y)
        for show, number in zip((*setters, self._set_width, self._set_height, self._set_shape), numbers, strict=True):
            show(number)

    def _look(self) -> tuple[float, ...]:
        self._observer.moved()
        seen = self._observer.mean(self._frames)
        if isinstance(seen, Fault):
            if seen.kind != "spot":
                raise seen.error
            return (0, *[math.nan] * 7)
        assert self._observer.last
        spot = self._observer.last[1]
        return 1, seen.x, seen.y, seen.error_x, seen.error_y, spot.width, spot.height, spot.shape_px
