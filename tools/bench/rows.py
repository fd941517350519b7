"""The table: what is measured, how it is judged, what the paper's sketch does."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import paper
from hanging import end_in_hang, stop_in_collection, stop_in_hang
from lab import Lab
from measure import (
    FRAMES,
    LATE_US,
    PULSES,
    SHORTEST_US,
    end_stop,
    first_after_record,
    frame_rate,
    frame_to_level,
    keep_alive,
    longest_pass,
    pulse_error,
    reset_to_answer,
    shortest_pulse,
    stop_behind,
    stop_in_a_pulse,
    stop_in_a_run,
    stop_in_a_stream,
    stop_in_queries,
)

CLOSED = "closed-"  # so the names of rows with the closed loop begin
HELD = 768  # bytes that USB and stdin take in before the firmware has read any


@dataclass(frozen=True)
class Figure:
    """A figure's unit and its limits: the most it may be, or with more_is_better the least.

    p99: the limits are for what 99 of 100 values keep to; else for the worst value.
    """

    unit: str
    must: float | None
    aim: float | None
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
FRAME = Figure("ms", 0.9, 0.3, p99=True)
FRAME_GATE = Figure("ms", 0.7, 0.3, p99=True)
STOP = Figure("ms", 0.5, None, p99=True)
STOP_GATE = Figure("ms", 0.01, 0.002, p99=True)
BUSY_STOP = Figure("ms", 0.8, None, p99=True)
BUSY_STOP_GATE = Figure("ms", 0.02, 0.006, p99=True)
COLLECTING = Figure("ms", None, None, p99=True)  # the loop never collects garbage while a motor is driven
HUNG = Figure("ms", 1000, None, p99=True)  # the watchdog
HUNG_END_GATE = Figure("ms", 0.005, 0.002, p99=True)
BEHIND = Figure("µs", 30, None, p99=True)
WIDTH = Figure("µs", 5, 2, p99=True)
WIDTH_GATE = Figure("µs", 3, 2, p99=True)
SHORTEST = Figure("ms", 1, 0.21)  # 0.2 ms, to 10 µs
RATE = Figure("1/s", 1000, 2000, more_is_better=True)
END_STOP = Figure("ms", 0.25, 0.1, p99=True)
END_STOP_GATE = Figure("ms", 0.2, 0.1, p99=True)
END_STOP_POLLED = Figure("ms", 2, 0.5)
RECORD = Figure("ms", 150, None)
RESET = Figure("ms", 800, 500)
ANY = Figure("ms", None, None)
PASS = Figure("ms", 1, 0.5, p99=True)
KEEP = Figure("ms", 2, None)

_FRAME = "last byte of a frame to both enables at level: "
_STOP = "`!` to both enables low: "
_STREAM = "to both enables low while 1000 frames/s come in"
_BEHIND = "`!` to both enables low, for each byte ahead of it: "
_RATE = f"frames per second, {FRAMES} in a row in order and none {LATE_US // 1000} ms late: "
_END_STOP = "end-stop to enable low: "
_PULSE = "pulses of 1 ms to 2 s, error: "
_PASS = "longest time from one look at the input to the next: "
_KEEP = "keep-alive: last byte to both enables low, less `XK`: "

_STEPS_AND_RUNS = (b"1PR2;2PR-2\n", b"1MV+;2MV-\n", b"ST\n")
_QUERIES = (b"*IDN?\n", b"XS?\n", b"TB?\n")


def _both(row: Row, gated: Figure, *, quick: bool = False) -> tuple[Row, Row]:
    """A row of the loop alone, and the same with the gate."""
    what = f"{row.what}, with the gate"
    return (
        replace(row, gate=False),
        replace(row, name=f"{row.name}-gate", what=what, figure=gated, gate=True, quick=quick, floor=None),
    )


def _frame(together: bool, full: bool, floor: float) -> tuple[Row, Row]:
    name = f"frame-{'burst' if together else 'alone'}-{'full' if full else 'part'}"
    what = f"{'in one burst' if together else '8th byte alone'}, {'full' if full else 'partial'} duty"
    measure = partial(frame_to_level, together=together, full=full)
    return _both(Row(name, _FRAME + what, FRAME, paper.FRAME, measure, quick=True, floor=floor), FRAME_GATE)


def _stop(
    name: str, what: str, there: str, measure: Callable[[Lab], list[float]], floor: float | None = None
) -> tuple[Row, Row]:
    return _both(Row(name, _STOP + what, STOP, there, measure, quick=True, floor=floor), STOP_GATE, quick=True)


def _busy_stop(
    name: str, what: str, measure: Callable[[Lab], list[float]], floor: float | None = None
) -> tuple[Row, Row]:
    return _both(Row(name, what, BUSY_STOP, paper.STOP_LOST, measure, quick=True, floor=floor), BUSY_STOP_GATE)


def _given_stop(name: str, what: str, *, zeros: bool) -> tuple[Row, ...]:
    """A stop in a stream, from when the host has it to give: how long USB makes it wait is in it."""
    measure = partial(stop_in_a_stream, zeros=zeros, landed=False)
    rows = _busy_stop(name, f"{what} {_STREAM}, from when the host has it", measure)
    return tuple(replace(row, figure=ANY, quick=False) for row in rows)


def _stop_behind(name: str, size: int, what: str, *, quick: bool = False) -> Row:
    measure = partial(stop_behind, size=size)
    what = f"{_BEHIND}{size} B, {what}"
    return Row(name, what, BEHIND, paper.STOP_LOST, measure, quick=quick)


def _end_in_hang(name: str, what: str, start: bytes) -> tuple[Row, Row]:
    row = Row(name, f"{what} ends late while the loop hangs", HUNG, "", partial(end_in_hang, start=start), most_n=20)
    return _both(row, HUNG_END_GATE)


def _pulse(name: str, axes: tuple[int, ...], what: str) -> tuple[Row, Row]:
    measure = partial(pulse_error, axes=axes, lengths=PULSES)
    return _both(Row(name, _PULSE + what, WIDTH, paper.PULSE_ERROR, measure), WIDTH_GATE)


def _end_stop(name: str, what: str, *, pulse: bool) -> tuple[Row, Row]:
    row = Row(name, _END_STOP + what, END_STOP, paper.NONE, partial(end_stop, pulse=pulse, polled=False))
    return _both(row, END_STOP_GATE)


def _pass(name: str, what: str, messages: tuple[bytes, ...]) -> Row:
    return Row(name, _PASS + what, PASS, paper.LONGEST_PASS, partial(longest_pass, messages=messages))


def _recorded(name: str, what: str, start: bytes) -> Row:
    what = f"first motion after the position was recorded, {what}: last byte to the enable at level"
    return Row(name, what, RECORD, paper.NONE, partial(first_after_record, start=start), most_n=100)


def _keep(name: str, what: str, start: bytes) -> Row:
    return Row(name, _KEEP + what, KEEP, paper.NEVER_STOPS, partial(keep_alive, start=start))


# Floors: measured on Debian's MicroPython 1.25.0, worst of 200, plus 25 %
_OPEN = (
    *_frame(together=True, full=True, floor=1.2),
    *_frame(together=True, full=False, floor=1.2),
    *_frame(together=False, full=True, floor=1.2),
    *_frame(together=False, full=False, floor=1.2),
    *_stop("stop-run", "in a run", paper.STOP, stop_in_a_run, floor=0.75),
    *_stop("stop-pulse", "in a pulse", paper.STOP_LATE, stop_in_a_pulse, floor=0.75),
    *_stop("stop-deaf", "host never reads", paper.STOP_LATE, partial(stop_in_a_run, reading=False), floor=0.75),
    *_busy_stop("stop-stream", f"`!` {_STREAM}", partial(stop_in_a_stream, zeros=False), floor=1.0),
    *_busy_stop("stop-stream-zeros", f"eight zeros {_STREAM}", partial(stop_in_a_stream, zeros=True), floor=1.1),
    *_given_stop("stop-stream-given", "`!`", zeros=False),
    *_given_stop("stop-stream-zeros-given", "eight zeros", zeros=True),
    *_busy_stop(
        "stop-queries", f"{_STOP}while lines `XS?` are executed, both axes in a run", stop_in_queries, floor=1.0
    ),
    *_both(
        Row("stop-collecting", f"{_STOP}while garbage is collected", COLLECTING, "", stop_in_collection), BUSY_STOP_GATE
    ),
    *_both(
        Row("stop-hanging", f"{_STOP}while the loop hangs", HUNG, paper.STOP_LATE, stop_in_hang, most_n=20),
        BUSY_STOP_GATE,
    ),
    _stop_behind("stop-full", HELD, "as many as USB and stdin hold", quick=True),
    _stop_behind("stop-overfull", 2 * HELD, "twice as many"),
    *_end_in_hang("end-pulse-hanging", "a pulse", b"1PR1\n"),
    *_end_in_hang("end-run-hanging", "a run, at its limit,", b"1MV+\n"),
    *_pulse("pulse-1", (1,), "axis 1"),
    *_pulse("pulse-2", (2,), "axis 2"),
    *_pulse("pulse-both", (1, 2), "both at once"),
    Row("shortest", "shortest pulse (`XP200`)", SHORTEST, paper.SHORTEST, shortest_pulse),
    Row(
        "shortest-error",
        "shortest pulse, error",
        WIDTH,
        paper.SHORTEST,
        partial(pulse_error, axes=(1,), lengths={SHORTEST_US: 1}),
    ),
    Row("rate", _RATE + "host reads", RATE, paper.FRAMES_PER_S, partial(frame_rate, reading=True)),
    Row("rate-deaf", _RATE + "host never reads", RATE, paper.FRAMES_PER_S, partial(frame_rate, reading=False)),
    *_end_stop("end-stop-run", "in a run", pulse=False),
    *_end_stop("end-stop-pulse", "in a pulse", pulse=True),
    Row(
        "end-stop-polled",
        f"{_END_STOP}in a run, on a port without interrupts",
        END_STOP_POLLED,
        paper.NONE,
        partial(end_stop, pulse=False, polled=True),
    ),
    _recorded("record-run", "a run", b"1MV+\n"),
    _recorded("record-frame", "a frame", b"02550000"),
    Row("reset", "reset to the answer to `*IDN?`", RESET, "", partial(reset_to_answer, source=False), most_n=20),
    Row("reset-source", "the same, deployed as .py", ANY, "", partial(reset_to_answer, source=True), most_n=20),
    _pass("pass-idle", "idle", (b"",)),
    _pass("pass-moving", "steps and runs", _STEPS_AND_RUNS),
    _pass("pass-echoing", "frames and echoes", (b"0255-100", b"-1000200")),
    _pass("pass-answering", "`*IDN?` `XS?` `TB?`", _QUERIES),
    Row("pass-health", _PASS + "`XH?` at rest", ANY, "", partial(longest_pass, messages=(b"XH?\n",))),
    _keep("keep-run", "a run", b";1MV+;2MV-\n"),
    _keep("keep-frame", "a frame", b"\n0255-255"),
    _keep("keep-pulse", "a pulse", b";1PR1;2PR-1\n"),
)

_ALSO_CLOSED = ("frame-burst-full", "frame-alone-part", "stop-run", "stop-pulse", "stop-stream", "stop-queries")
ROWS = _OPEN + tuple(
    replace(row, name=CLOSED + row.name, what=f"{row.what}, closed loop", closed=True, quick=False, floor=None)
    for row in _OPEN
    if row.name.removesuffix("-gate") in _ALSO_CLOSED
)
