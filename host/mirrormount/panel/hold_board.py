"""What a loop that holds a beam has told, kept for its page: state, reasons, errors, history, alarms. Pure.

listen() takes the loop's events (beam/events.py) in the loop's thread; told() is called by the web server's.
"""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from mirrormount.beam.control import events
from mirrormount.beam.control.events import Pair, SpotMissed, SpotSeen

ALARM, WARN, CALM = "alarm", "warn", ""
_KEPT = 1200  # looks in the history
_EVERY_S = 0.5  # between two of them: ten minutes are kept
_RMS_S = 60.0  # over which the scatter is told
_LAST = 6  # corrections and interlocks in words


class HoldBoard:
    """The last state of one loop. um_per_px: of each camera, for the errors of its spot."""

    def __init__(
        self, um_per_px: Mapping[str, Pair] | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._um_per_px = dict(um_per_px or {})
        self._clock = clock
        self._lock = threading.Lock()
        self._state, self._why = "", "the loop has not begun"
        self._tripped: events.InterlockTripped | None = None
        self._progress: events.Progress | None = None
        self._look: events.Observed | None = None
        self._heard_s: float | None = None
        self._history: deque[dict[str, Any]] = deque(maxlen=_KEPT)
        self._kept_s = -math.inf
        self._estimate: events.Estimated | None = None  # the last one, unless an interlock has tripped since
        self._recent: deque[tuple[float, ...]] = deque()  # time, seconds; times these: squares of um, of urad x and y
        self._number = -1  # of the last correction
        self._counts = {"corrections": 0, "pulses": 0, "reversals": 0, "interlocks": 0}
        self._news: deque[str] = deque(maxlen=_LAST)

    def listen(self, event: events.Event) -> None:
        """Take an event of the loop."""
        with self._lock:
            self._heard_s = self._clock()
            match event:
                case events.Observed():
                    self._looked(event)
                case events.Estimated():
                    self._estimated(event)
                case events.Pulsed():
                    self._counts["pulses"] += 1
                case events.Corrected():
                    self._counts["corrections"] += event.number != self._number  # a creep is told pulse by pulse
                    self._number = event.number
                    self._counts["reversals"] += len(event.reversals)
                    self._news.append(_correction(event))
                case events.StateChanged():
                    self._state, self._why = event.state, event.why
                    self._progress = None
                case events.InterlockTripped():
                    self._counts["interlocks"] += 1
                    self._estimate = None
                    self._tripped = event  # the last one is the one that has to be cleared
                    self._news.append(f"interlock {event.number}, {event.name}: {event.cause}")
                case events.InterlockCleared():
                    self._tripped = None
                    self._news.append(f"interlock {event.number}, {event.name}: cleared")
                case events.Progress():
                    self._progress = event
                case _:
                    pass

    def _looked(self, look: events.Observed) -> None:
        self._look = look
        while self._recent and self._recent[0][0] < look.time_s - _RMS_S:
            self._recent.popleft()
        if look.time_s - self._kept_s >= _EVERY_S:
            self._kept_s = look.time_s
            off = [spot.error_um if isinstance(spot, SpotSeen) else None for spot in look.spots]
            self._history.append({"t": round(look.time_s, 2), "off": off, "free": look.free_um})

    def _estimated(self, estimate: events.Estimated) -> None:
        """The one before has counted until now, as in ErrorStatistics."""
        if before := self._estimate:
            seconds = estimate.time_s - before.time_s
            um = max(abs(each) for pair in before.errors_um.values() for each in pair)
            x, y = before.angle_urad or (math.nan, math.nan)
            self._recent.append((estimate.time_s, seconds, seconds * um**2, seconds * x**2, seconds * y**2))
        self._estimate = estimate

    @property
    def alert(self) -> str:
        """ALARM: a person has to act. WARN: an interlock has tripped that may clear itself. CALM: neither."""
        tripped = self._tripped
        if self._state == events.STOPPED or (tripped and not tripped.clears_itself):
            return ALARM
        return WARN if self._state == events.WAITING or tripped else CALM

    def told(self, after_s: float = -math.inf) -> dict[str, Any]:
        """All that a page shows, as JSON. after_s: of the history only what is later, on the loop's clock."""
        with self._lock:
            now_s = self._clock()
            seen, tripped = self._look, self._tripped
            return {
                "state": self._state,
                "why": self._why,
                "alert": self.alert,
                "silent_s": None if self._heard_s is None else round(now_s - self._heard_s, 1),
                "progress": [self._progress.done, self._progress.what] if self._progress else None,
                "interlocks": [[tripped.name, tripped.cause, tripped.remedy, tripped.clears_itself]] if tripped else [],
                "cameras": [self._camera(spot, at) for at, spot in enumerate(seen.spots)] if seen else [],
                "angle": _rounded(seen.angle_urad) if seen and seen.angle_urad else None,
                "rms": self._rms(),
                "counts": dict(self._counts),
                "news": list(self._news)[::-1],
                "history": [point for point in self._history if point["t"] > after_s],
            }

    def _camera(self, spot: SpotSeen | SpotMissed, at: int) -> dict[str, Any]:
        free = self._look.free_um if self._look else ()
        told: dict[str, Any] = {"name": spot.camera, "free": _rounded(free[at]) if at < len(free) else None}
        if isinstance(spot, SpotMissed):
            return told | {"missed": spot.reason}
        per_px = self._um_per_px.get(spot.camera)
        sigma = _rounded((spot.sigma_px[0] * per_px[0], spot.sigma_px[1] * per_px[1])) if per_px else None
        return told | {"off": _rounded(spot.error_um), "sigma": sigma}

    def _rms(self) -> dict[str, float | None]:
        """Over the last minute: of the worst error along an axis in any camera, and of the beam's angle (x or y)."""
        _, seconds, *squares = (sum(part) for part in zip(*self._recent, strict=True)) if self._recent else (0.0, 0.0)
        if not seconds:
            return {"um": None, "urad": None}
        um, x, y = (math.sqrt(square / seconds) for square in squares)
        return {"um": _known(um), "urad": _known(max(x, y))}


def _correction(event: events.Corrected) -> str:
    steps = ", ".join(f"{name} {steps:+.3f}" for name, steps in event.steps.items() if steps).replace("-", "−")
    before, after = (max(map(abs, um), default=0.0) for um in (event.before_um, event.after_um))
    return f"correction {event.number}: {steps or 'nothing'} steps; worst error {before:.0f} → {after:.0f} µm"


def _known(number: float) -> float | None:
    return round(number, 1) if math.isfinite(number) else None


def _rounded(pair: Pair) -> list[float | None]:
    return [_known(number) for number in pair]
