"""The table: what is measured, how it is judged, and what the paper's sketch does.

The sketch is the mount's first controller (M. Gopalakrishnan and M. Guehr, A low-cost mirror mount control system for
optics setups, Appendix A).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from lab import Lab
from measure import (
    FRAMES,
    LATE_US,
    PULSES,
    SHORTEST_US,
    end_in_hang,
    end_stop,
    first_after_record,
    frame_rate,
    frame_to_level,
    free_memory,
    keep_alive,
    pulse_error,
    reset_to_answer,
    stop_behind,
    stop_in_a_pulse,
    stop_in_a_run,
    stop_in_a_stream,
    stop_in_hang,
    stop_in_queries,
)

CLOSED = "closed-"  # so the names of rows with the closed loop begin
HELD = 768  # bytes that USB and stdin take in before the firmware has read any

PAPER_SOURCE = (
    "the paper's sketch (Appendix A) compiled unchanged, on an emulated ATmega328P at 16 MHz, simavr 1.6,"
    " true 9600-baud bytes"
)

_PAPER_FRAME = "34.6 / 84.8 ms"  # last byte to enable of motor 1 / motor 2: medians of 60; at most 35.6 / 85.8
_PAPER_STOP = "34.3 / 84.4 ms"  # last byte of `00000000` to enable 1 / 2 low, nothing else going on: medians of 60
_PAPER_STOP_LATE = (
    "34 ms to never"  # lost in 20 cases of 20 within 32 ms after another frame; then 135 ms, falling to 34
)
_PAPER_STOP_LOST = "lost"
_PAPER_PULSE_ERROR = "sd 0.84 to 1.9 ms"  # 0.2 s timed by its host: without jitter of the host, and with 5 ms of it
_PAPER_SHORTEST = "142.85 ms"
_PAPER_FRAMES_PER_S = "6.99"  # one in 143 ms: 100 of 100 obeyed
_PAPER_NEVER_STOPS = "runs for ever"  # watched for 300 s


@dataclass(frozen=True)
class Figure:
    """A figure's unit and its limit: the most it may be, or with more_is_better the least.

    p99: the limit is for what 99 of 100 values keep to; else for the worst value.
    """

    unit: str
    must: float
    more_is_better: bool = False
    p99: bool = False


@dataclass(frozen=True)
class Row:
    """A line of the table. most_n: for what takes long. gate: True with the gate, False without it, None: as built.

    closed: with encoders, and both axes in the closed loop.
    quick: measured by --quick, which judges the worst of few values. floor: it demands this then, not the must: the
    worst of 200 values, plus 25 % for code that moves in flash. Only ever tightened, and removed when it is a must's.
    """

    name: str
    what: str
    figure: Figure
    paper: str
    measure: Callable[[Lab], list[float]]
    most_n: int | None = None
    gate: bool | None = None
    closed: bool = False
    quick: bool = False
    floor: float | None = None


# the loop alone, and below each one with the gate
_FRAME = Figure("ms", 0.9, p99=True)
_FRAME_GATE = Figure("ms", 0.7, p99=True)
_STOP = Figure("ms", 1, p99=True)
_STOP_GATE = Figure("ms", 0.01, p99=True)
_BUSY_STOP_GATE = Figure("ms", 0.02, p99=True)
_HUNG = Figure("ms", 1000, p99=True)  # the watchdog
_HUNG_END_GATE = Figure("ms", 0.005, p99=True)
_BEHIND = Figure("µs", 30, p99=True)
_WIDTH = Figure("µs", 5, p99=True)
_WIDTH_GATE = Figure("µs", 3, p99=True)
_END_STOP = Figure("ms", 0.25, p99=True)
_END_STOP_GATE = Figure("ms", 0.2, p99=True)


def _both(row: Row, gated: Figure, *, quick: bool = False) -> tuple[Row, Row]:
    """A row of the loop alone, and the same with the gate."""
    what = f"{row.what}, with the gate"
    return (
        replace(row, gate=False),
        replace(row, name=f"{row.name}-gate", what=what, figure=gated, gate=True, quick=quick, floor=None),
    )


def _frame(name: str, what: str, *, together: bool, full: bool, floor: float) -> tuple[Row, Row]:
    what = f"last byte of a frame to both enables at level: {what}"
    measure = partial(frame_to_level, together=together, full=full)
    return _both(Row(name, what, _FRAME, _PAPER_FRAME, measure, quick=True, floor=floor), _FRAME_GATE)


def _stop(
    name: str,
    what: str,
    paper: str,
    measure: Callable[[Lab], list[float]],
    gated: Figure = _STOP_GATE,
    floor: float | None = None,
) -> tuple[Row, Row]:
    row = Row(name, f"{what} to both enables low", _STOP, paper, measure, quick=True, floor=floor)
    return _both(row, gated, quick=gated == _STOP_GATE)


_STREAM = "while 1000 frames/s come in,"
# Floors: measured on Debian's MicroPython 1.25.0, worst of 200, plus 25 %
_OPEN = (
    *_frame("frame-burst", "in one burst, full duty", together=True, full=True, floor=1.2),
    *_frame("frame-alone", "8th byte alone, partial duty", together=False, full=False, floor=1.2),
    *_stop("stop-run", "in a run, `!`", _PAPER_STOP, stop_in_a_run),
    *_stop("stop-pulse", "in a pulse, `!`", _PAPER_STOP_LATE, stop_in_a_pulse),
    *_stop("stop-deaf", "where the host never reads, `!`", _PAPER_STOP_LATE, partial(stop_in_a_run, reading=False)),
    *_stop("stop-stream", f"{_STREAM} `!`", _PAPER_STOP_LOST, partial(stop_in_a_stream, zeros=False), _BUSY_STOP_GATE),
    *_stop(
        "stop-stream-zeros",
        f"{_STREAM} eight zeros",
        _PAPER_STOP_LOST,
        partial(stop_in_a_stream, zeros=True),
        _BUSY_STOP_GATE,
        floor=1.1,
    ),
    *_stop("stop-queries", "while lines `XS?` are executed, `!`", _PAPER_STOP_LOST, stop_in_queries, _BUSY_STOP_GATE),
    Row(
        "stop-full",
        f"`!` behind {HELD} B, as many as USB and stdin hold, to both enables low: for each of these bytes",
        _BEHIND,
        _PAPER_STOP_LOST,
        partial(stop_behind, size=HELD),
        quick=True,
    ),
    *_both(
        Row(
            "hanging-stop",
            "while the loop hangs, `!` to both enables low",
            _HUNG,
            _PAPER_STOP_LATE,
            stop_in_hang,
            most_n=20,
        ),
        _BUSY_STOP_GATE,
    ),
    *_both(
        Row("hanging-end", "while the loop hangs, a run ends later than its limit", _HUNG, "", end_in_hang, most_n=20),
        _HUNG_END_GATE,
    ),
    *_both(
        Row(
            "pulse",
            "pulses of 1 ms to 2 s of both axes at once, error",
            _WIDTH,
            _PAPER_PULSE_ERROR,
            partial(pulse_error, axes=(1, 2), lengths=PULSES),
        ),
        _WIDTH_GATE,
    ),
    Row(
        "pulse-shortest",
        "shortest pulse (`XP200`: 0.2 ms), error",
        _WIDTH,
        _PAPER_SHORTEST,
        partial(pulse_error, axes=(1,), lengths={SHORTEST_US: 1}),
    ),
    Row(
        "rate",
        f"frames per second, {FRAMES} in a row in order and none {LATE_US // 1000} ms late",
        Figure("1/s", 1000, more_is_better=True),
        _PAPER_FRAMES_PER_S,
        frame_rate,
    ),
    *_both(Row("end-stop", "end-stop to enable low, in a run", _END_STOP, "none", end_stop), _END_STOP_GATE),
    Row(
        "keep-alive",
        "silence of the host to both enables low, less `XK`",
        Figure("ms", 2),
        _PAPER_NEVER_STOPS,
        keep_alive,
    ),
    Row(
        "record",
        "first run after the position was recorded: last byte to the enable at level",
        Figure("ms", 150),
        "none",
        first_after_record,
        most_n=100,
    ),
    Row("reset", "reset to the answer to `*IDN?`", Figure("ms", 1200), "", reset_to_answer, most_n=20),
    Row("memory", "free memory", Figure("KB", 100, more_is_better=True), "", free_memory),
)

_ALSO_CLOSED = ("frame-burst", "stop-run", "stop-stream")
ROWS = _OPEN + tuple(
    replace(row, name=CLOSED + row.name, what=f"{row.what}, closed loop", closed=True, quick=False, floor=None)
    for row in _OPEN
    if row.name.removesuffix("-gate") in _ALSO_CLOSED
)

# what somebody asks for: --update writes these into docs/performance.md
ON_THE_PAGE = (
    "frame-burst",
    "frame-alone",
    "stop-run",
    "stop-run-gate",
    "stop-stream",
    "stop-stream-gate",
    "hanging-stop",
    "hanging-stop-gate",
    "pulse",
    "pulse-shortest",
    "rate",
    "end-stop",
    "keep-alive",
    "record",
    "reset",
)
