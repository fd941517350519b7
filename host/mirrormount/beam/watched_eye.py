"""An eye of a loop whose frames pages can look at: the loop finds the spots, and who looks on waits for nothing."""

import time
from collections.abc import Iterator, Sequence

from mirrormount.beam import NoSpot, Spot
from mirrormount.beam.camera import Frame, Size
from mirrormount.beam.control.interfaces import Actuator, Eye, LoopTable
from mirrormount.beam.live import Seen, as_jpeg
from mirrormount.common.errors import MountError
from mirrormount.common.printable import printable

_OLD_S = 3.0  # a loop that corrects looks at no frames for about a second


class WatchedEye:
    """As the eye that it wraps; last, trouble and jpeg() as of LiveCamera, from any thread."""

    def __init__(self, eye: Eye) -> None:
        self._eye = eye
        self._seen: Seen | None = None
        self._failure = "no picture yet"
        self._jpeg: tuple[int, bytes] = (0, b"")

    @property
    def name(self) -> str:
        return self._eye.name

    @property
    def size(self) -> Size:
        return self._eye.size

    @property
    def target_px(self) -> tuple[float, float]:
        return self._eye.target_px

    @property
    def um_per_px(self) -> tuple[float, float]:
        return self._eye.um_per_px

    @property
    def distance_m(self) -> float | None:
        return self._eye.distance_m

    def monotonic(self) -> float:
        """As Eye.monotonic()."""
        return self._eye.monotonic()

    def frames(self) -> Iterator[Frame]:
        """As Eye.frames(). What it raises is told to those who look on, too."""
        try:
            yield from self._eye.frames()
        except MountError as e:
            self._failure = printable(str(e), 300)
            raise

    def find(self, frame: Frame) -> Spot | NoSpot:
        """As Eye.find(); the frame and what was found are what pages see next."""
        found = self._eye.find(frame)
        at_s = time.monotonic() - max(0.0, self._eye.monotonic() - frame.time_s)
        self._seen = Seen(self._seen.number + 1 if self._seen else 1, frame, found, at_s)
        self._failure = ""
        return found

    # ---- for pages

    @property
    def last(self) -> Seen | None:
        """The frame that the loop looked at last; None before the first."""
        return self._seen

    @property
    def trouble(self) -> str:
        """Why the last frame does not show what is there now, in one line; "" if it does."""
        seen = self._seen
        if self._failure or seen is None:
            return self._failure
        age_s = time.monotonic() - seen.at_s
        return f"{self.name}: the loop has looked at no picture for {age_s:.0f} s" if age_s > _OLD_S else ""

    def jpeg(self, seen: Seen) -> bytes:
        """As LiveCamera.jpeg()."""
        number, data = self._jpeg
        if number != seen.number:
            data = as_jpeg(seen.frame.image)
            self._jpeg = seen.number, data
        return data


class WatchedTable:
    """As the table that it wraps, with eyes that pages can look at."""

    def __init__(self, table: LoopTable) -> None:
        self._table = table
        self.eyes = [WatchedEye(eye) for eye in table.eyes]

    @property
    def actuators(self) -> Sequence[Actuator]:
        return self._table.actuators

    @property
    def taken_over(self) -> str:
        """As LoopTable.taken_over."""
        return self._table.taken_over

    @property
    def lost_board(self) -> str:
        """As LoopTable.lost_board."""
        return self._table.lost_board

    def now_s(self) -> float:
        """As LoopTable.now_s()."""
        return self._table.now_s()

    def sleep(self, seconds: float) -> None:
        """As LoopTable.sleep()."""
        self._table.sleep(seconds)

    def stop(self) -> None:
        """As LoopTable.stop()."""
        self._table.stop()

    def take_control(self) -> None:
        """As LoopTable.take_control()."""
        self._table.take_control()
