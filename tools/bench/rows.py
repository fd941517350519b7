"""The table: what is measured, how it is judged, what the paper's sketch does."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import paper
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
)

HELD = 768  # bytes that USB and stdin take in before the firmware has read any


@dataclass(frozen=True)
class Figure:
    """A figure's unit and its limits, for the worst value: the most it may be, or with more_is_better the least."""

    unit: str
    must: float | None
    aim: float | None
    more_is_better: bool = False


@dataclass(frozen=True)
class Row:
    """A line of the table. most_n: for what takes long."""

    name: str
    what: str
    figure: Figure
    paper: str
    measure: Callable[[Lab], list[float]]
    most_n: int | None = None


FRAME = Figure("ms", 2, 0.5)
STOP = Figure("ms", 1, 0.3)
STREAM = Figure("ms", 1, 0.5)
BEHIND = Figure("µs", 40, None)
WIDTH = Figure("µs", 50, 10)
SHORTEST = Figure("ms", 1, 0.21)  # 0.2 ms, to WIDTH's aim
RATE = Figure("1/s", 500, 1000, more_is_better=True)
END_STOP = Figure("ms", 1, 0.1)
END_STOP_POLLED = Figure("ms", 2, 0.5)
RECORD = Figure("ms", 150, None)
RESET = Figure("ms", 1500, 500)
ANY = Figure("ms", None, None)
PASS = Figure("ms", 2, 0.5)
KEEP = Figure("ms", 2, None)

_FRAME = "last byte of a frame to both enables at level: "
_STOP = "`!` to both enables low: "
_STREAM = "to both enables low while 1000 frames/s come in"
_BEHIND = "`!` to both enables low, for each byte ahead of it: "
_RATE = f"frames per second, {FRAMES} in a row in order and none {LATE_US // 1000} ms late: "
_PULSE = "pulses of 1 ms to 2 s, error: "
_PASS = "longest time from one look at the input to the next: "
_KEEP = "keep-alive: last byte to both enables low, less `XK`: "

_STEPS_AND_RUNS = (b"1PR2;2PR-2\n", b"1MV+;2MV-\n", b"ST\n")
_QUERIES = (b"*IDN?\n", b"XS?\n", b"TB?\n")


def _frame(together: bool, full: bool) -> Row:
    name = f"frame-{'burst' if together else 'alone'}-{'full' if full else 'part'}"
    what = f"{'in one burst' if together else '8th byte alone'}, {'full' if full else 'partial'} duty"
    return Row(name, _FRAME + what, FRAME, paper.FRAME, partial(frame_to_level, together=together, full=full))


def _stop_behind(name: str, size: int, what: str) -> Row:
    return Row(name, f"{_BEHIND}{size} B, {what}", BEHIND, paper.STOP_LOST, partial(stop_behind, size=size))


def _pulse(name: str, axes: tuple[int, ...], what: str) -> Row:
    return Row(name, _PULSE + what, WIDTH, paper.PULSE_ERROR, partial(pulse_error, axes=axes, lengths=PULSES))


def _end_stop(name: str, what: str, *, pulse: bool, polled: bool = False) -> Row:
    figure = END_STOP_POLLED if polled else END_STOP
    measure = partial(end_stop, pulse=pulse, polled=polled)
    return Row(name, f"end-stop to enable low: {what}", figure, paper.NONE, measure)


def _pass(name: str, what: str, messages: tuple[bytes, ...]) -> Row:
    return Row(name, _PASS + what, PASS, paper.LONGEST_PASS, partial(longest_pass, messages=messages))


def _recorded(name: str, what: str, start: bytes) -> Row:
    what = f"first motion after the position was recorded, {what}: last byte to the enable at level"
    return Row(name, what, RECORD, paper.NONE, partial(first_after_record, start=start), most_n=100)


def _keep(name: str, what: str, start: bytes) -> Row:
    return Row(name, _KEEP + what, KEEP, paper.NEVER_STOPS, partial(keep_alive, start=start))


ROWS = (
    _frame(together=True, full=True),
    _frame(together=True, full=False),
    _frame(together=False, full=True),
    _frame(together=False, full=False),
    Row("stop-run", _STOP + "in a run", STOP, paper.STOP, stop_in_a_run),
    Row("stop-pulse", _STOP + "in a pulse", STOP, paper.STOP_LATE, stop_in_a_pulse),
    Row("stop-deaf", _STOP + "host never reads", STOP, paper.STOP_LATE, partial(stop_in_a_run, reading=False)),
    Row("stop-stream", f"`!` {_STREAM}", STREAM, paper.STOP_LOST, partial(stop_in_a_stream, zeros=False)),
    Row("stop-stream-zeros", f"eight zeros {_STREAM}", STREAM, paper.STOP_LOST, partial(stop_in_a_stream, zeros=True)),
    _stop_behind("stop-full", HELD, "as many as USB and stdin hold"),
    _stop_behind("stop-overfull", 2 * HELD, "twice as many"),
    _pulse("pulse-1", (1,), "axis 1"),
    _pulse("pulse-2", (2,), "axis 2"),
    _pulse("pulse-both", (1, 2), "both at once"),
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
    _end_stop("end-stop-run", "in a run", pulse=False),
    _end_stop("end-stop-pulse", "in a pulse", pulse=True),
    _end_stop("end-stop-polled", "in a run, on a port without interrupts", pulse=False, polled=True),
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
