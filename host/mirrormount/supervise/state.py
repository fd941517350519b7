"""The last known state of the mount, for display. One thread writes it, any thread reads it."""

import time
from collections import deque
from collections.abc import Callable

from mirrormount.device.mount import Mount
from mirrormount.device.status import Status
from mirrormount.supervise import scales
from mountfw import codes as wire

POLL_S = 0.05  # period of the status polls
_KNOWN_S = 0.6  # an older status is not the present one
_KEPT_S = 120.0  # of the positions, for the plot

Point = tuple[float, tuple[float, ...] | None]  # when; the position of each axis, None where not known


class State:
    """status: None while it is not known; last: the last that was known; seen_s: when that came, monotonic.

    axes: the names of the mount's axes. positions: of the last two minutes. targets: of moves under way.
    scales: of each axis, None if not measured. stopped_by: of each axis whose last motion was aborted, why.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.axes: tuple[str, ...] = ("x", "y")
        self.status: Status | None = None
        self.last: Status | None = None
        self.seen_s = 0.0
        self.positions: deque[Point] = deque(maxlen=round(_KEPT_S / POLL_S))
        self.targets: dict[str, float | None] = {}
        self.scales: scales.Scales = {}
        self.stopped_by: dict[str, str] = {}

    def connect(self, mount: Mount) -> None:
        """A board has come. Raises MountError."""
        self.read_scales(mount)
        self.axes = tuple(mount.by_name)
        self.targets = {}
        self.stopped_by = {}

    def read_scales(self, mount: Mount) -> None:
        """Look the scales up for the board's present settings. Raises MountError."""
        self.scales = scales.read(mount)

    def began(self, axis: str | None) -> None:
        """A motion of this axis has begun; None: of all."""
        for name in [name for name in self.stopped_by if axis in (None, name)]:
            del self.stopped_by[name]

    def update(self, status: Status, stop_cause: str = "") -> None:
        """A status has come. stop_cause: of the last stop; a later one says nothing of an axis that is at rest."""
        for name, axis in status.by_name.items():
            if axis.moving or axis.reason != wire.ABORTED:
                self.began(name)
            else:
                self.stopped_by.setdefault(name, stop_cause)
        self.seen_s = self._clock()
        self.positions.append((self.seen_s, tuple(axis.position for axis in status.by_name.values())))
        self.status = self.last = status

    def lose(self) -> None:
        """The board has gone."""
        self.status = None
        self.positions.append((self._clock(), None))

    @property
    def is_known(self) -> bool:
        """True while the status is recent."""
        return self.status is not None and self._clock() - self.seen_s < _KNOWN_S

    @property
    def seen_at(self) -> str:
        """When the last status came, in wall-clock time."""
        return time.strftime("%H:%M:%S", time.localtime(time.time() - (self._clock() - self.seen_s)))

    def angle_text(self, name: str, steps: float) -> str:
        """A position in mrad of the mirror, and in mm on the screen if that is known; "" where no scale is known."""
        scale = self.scales.get(name)
        if scale is None:
            return ""
        screen = "" if scale.screen_mm is None else f", {steps * scale.screen_mm:+.2f} mm"
        return f"≈ {steps * scale.mirror_mrad:+.2f} mrad{screen}".replace("-", "−")

    def step_text(self) -> str:
        """What a step of each axis is, in units of mirror, beam and screen; in steps where no scale is known."""
        return " ".join(_step_text(name, self.scales.get(name)) for name in self.axes)


def _step_text(name: str, scale: scales.AxisScale | None) -> str:
    if scale is None:
        return f"{name}: no scale, so steps only."
    parts = [f"{scale.mirror_mrad * 1e3:.3g} µrad of the mirror"]
    if scale.beam_mrad is not None:
        parts.append(f"{scale.beam_mrad * 1e3:.3g} µrad of the beam")
    if scale.screen_mm is not None:
        parts.append(f"{scale.screen_mm:.3g} mm on the screen")
    return f"{name}: a step is about {', '.join(parts)}."
