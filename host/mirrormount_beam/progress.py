"""The line that a loop, a measurement or a scan writes over and over, on a terminal and in a cell of a notebook.

with LoopLine() as tell:
    align(table, response, gaps, tell)
with MeasurementLine(mount) as tell:
    steps.run(rig, result, tell)
with ScanLine(pattern) as tell:
    for sample in scan(mount, pattern, signal):
        tell(sample)
"""

from typing import Self

from mirrormount.device.mount import Mount
from mirrormount.terminal import StatusLine
from mirrormount_beam.control.events import Event, InterlockCleared, InterlockTripped, Progress, StateChanged
from mirrormount_beam.scan import Pattern, Sample


class _Line:
    """A status line that is cleared at the end."""

    def __init__(self) -> None:
        self._line = StatusLine()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._line.end()


class LoopLine(_Line):
    """Takes the events of a loop: state and progress on the line, interlocks on lines of their own."""

    def __call__(self, event: Event) -> None:
        """As Listen."""
        match event:
            case InterlockTripped():
                self.say(event, f"interlock {event.number}, {event.name}: {event.cause}; {event.remedy}")
            case InterlockCleared():
                self.say(event, f"interlock {event.number}, {event.name}, is cleared; the loop goes on")
            case StateChanged():
                self._line.show(f"{event.time_s:8.1f} s  {event.state}: {event.why}"[:110])
            case Progress():
                self._line.show(f"{event.done:4.0%}  {event.what}")
            case _:
                pass

    def say(self, event: Event, text: str) -> None:
        """Print a line that stays."""
        self._line.end()
        print(f"{event.time_s:.1f} s: {text}")


class MeasurementLine(_Line):
    """Takes the part of an experiment that is done; the time that is left is by the mount's clock."""

    def __init__(self, mount: Mount) -> None:
        super().__init__()
        self._link = mount.link
        self._begun_s = mount.link.monotonic()

    def __call__(self, done: float, phase: str) -> None:
        """As Tell."""
        passed_s = self._link.monotonic() - self._begun_s
        left = f", {passed_s * (1 / done - 1) / 60:.1f} min left" if done > 0.02 else ""
        self._line.show(f"{done:4.0%}{left}  {phase}  (Ctrl-C stops and keeps what was measured)")


class ScanLine(_Line):
    """Takes samples: how many places are measured, the time that is left on the mount's clock, the last values."""

    def __init__(self, pattern: Pattern, *, keeps: bool = True) -> None:
        super().__init__()
        self._of = pattern.measured
        self._line.show(f"0/{self._of}  (Ctrl-C stops{' and keeps what was measured' * keeps})")

    def __call__(self, sample: Sample) -> None:
        """After each sample."""
        done = sample.number + 1
        left_min = sample.time_s / done * (self._of - done) / 60
        values = sample.missing or "  ".join(f"{value:.4g}" for value in sample.values)
        self._line.show(f"{done}/{self._of}, {left_min:.1f} min left  ({sample.x}, {sample.y}): {values[:60]}")
