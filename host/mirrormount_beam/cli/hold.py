"""`mirrormount calibrate | align | hold | report`: measure what the mounts do to the beam, align it, hold it.

The commands open the table, take the saved calibration or measure a new one, run the loop, and write its files.
`report` makes the page of a run from its log.
"""

import argparse
import contextlib
import json
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from mirrormount import files
from mirrormount.cli.arguments import (
    Command,
    camera_settings,
    from_extra,
    number,
    open_option,
    page_of,
    patience_of,
    patience_option,
    positive,
    selection_options,
    table_option,
    tell_page,
    virtual_address,
    virtual_options,
    web_options,
    whole,
)
from mirrormount.device import calibration
from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue, CannotWrite
from mirrormount.terminal import ended_in_order
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_table
from mirrormount_beam.cameras import select
from mirrormount_beam.control.backlash import Gap
from mirrormount_beam.control.calibrate import Calibration, check_controllable
from mirrormount_beam.control.events import Event, Listen
from mirrormount_beam.control.hold import Hold, Summary, align
from mirrormount_beam.control.interfaces import LoopTable
from mirrormount_beam.control.response import Response, check_place, load, save
from mirrormount_beam.progress import LoopLine
from mirrormount_beam.runlog import RunLog
from mirrormount_beam.table import LocalTable, Table


class LoopPage(Protocol):
    """The page of --page, of the panel's package. board takes the loop's events; hold is what HOLD tells to go on."""

    board: Any
    hold: Hold | None


# ---- a run

_NUMBERS_BEGIN = '{\n "reached": '  # the file of --json
_VIRTUAL_S = 3600.0  # of a virtual hold, unless another duration is asked for


def run(verb: str, args: argparse.Namespace) -> int:
    """Run one of the three; the exit status: 0 only if the goal was met. Raises MountError."""
    if verb == "align" and args.signal:
        from mirrormount_beam.cli.signal import run_signal

        return run_signal(args)
    goals = _goals(verb, args)
    check_numbers(args.json)
    path = args.calibration or (None if args.virtual else calibration.path().with_name("table-calibration.json"))
    if path:
        check_place(path)
    with ended_in_order(), contextlib.ExitStack() as stack:
        table, halt = stack.enter_context(_virtual(args) if args.virtual else _real(args))
        check_controllable(table)
        page: LoopPage | None = (
            stack.enter_context(page_of("hold")(args, table, halt)) if verb == "hold" and args.page else None
        )
        tell = stack.enter_context(told(args, page.board.listen if page else None))
        if verb == "calibrate":
            response, _ = _calibrated(table, tell)
            result = {"reached": True, "seconds": round(table.now_s(), 3)} | response.to_json()
            _keep(response, path, args.json, result)
            if path:
                print(path)
            return 0
        response, gaps, fresh = _response(table, tell, path)
        if verb == "align":
            summary = align(table, response, gaps, tell, **goals)
            _tell_align(summary)
            _keep(response, path, args.json, summary.to_json(final=True))
            return 0 if summary.reached else 1
        if fresh:
            _tell_align(align(table, response, gaps, tell))
        goals_of_hold = {key: goals[key] for key in ("rms_urad", "most_um")}
        hold = Hold(table, response, gaps if fresh else None, tell, **goals_of_hold)
        if page:
            page.hold = hold
        _hold(hold, goals["seconds"], path, args.json)
        return 0 if hold.summary.reached else 1


def _hold(hold: Hold, seconds: float | None, path: Path | None, numbers: Path | None) -> None:
    """Hold until the end or Ctrl-C. However it ends, what was learned is told and kept. Raises MountError."""
    try:
        with contextlib.suppress(KeyboardInterrupt):
            hold.run(seconds)
    finally:
        try:
            _tell_hold(hold.summary)
        finally:  # there may be no terminal any more
            _keep(hold.response, path, numbers, hold.summary.to_json(final=False))


def _goals(verb: str, args: argparse.Namespace) -> dict[str, Any]:
    """What is asked for, checked before anything is opened. Raises BadValue."""
    number(args.off, "--off")
    patience_of(args)
    if verb == "align":
        most = whole(args.most, "--most")
        if most < 1:
            raise BadValue(f"--most is 1 or more, not {most}")
        return {"within_um": positive(args.within, "--within"), "most": most}
    if verb == "hold":
        unbounded = _VIRTUAL_S if args.virtual else None
        seconds = unbounded if args.duration is None else positive(args.duration, "--duration")
        rms_urad = None if args.rms_urad is None else positive(args.rms_urad, "--rms-urad")
        return {"seconds": seconds, "rms_urad": rms_urad, "most_um": positive(args.max_um, "--max-um")}
    return {}


# ---- tables


@contextlib.contextmanager
def _virtual(args: argparse.Namespace) -> Iterator[tuple[LoopTable, None]]:
    """The virtual table in lockstep, its mounts driven from here."""
    with virtual_table(args) as (loop, _, _):
        yield loop, None


@contextlib.contextmanager
def virtual_table(args: argparse.Namespace) -> Iterator[tuple[LocalTable, Any, dict[str, Mount]]]:
    """The same, with the table itself and its mounts."""
    settings = camera_settings(args)
    address = virtual_address(args, "virtual-table", mounts=args.mounts, cameras=args.cameras, off=args.off)
    assert address is not None
    with contextlib.closing(open_table(address)) as table, contextlib.ExitStack() as stack:
        names = ("first", "second")[: int(args.mounts)]
        mounts = {name: stack.enter_context(Mount(Link(port))) for name, port in zip(names, table.ports, strict=True)}
        for camera in table.cameras:
            select(camera, settings)
        yield LocalTable.of_virtual(table, mounts), table, mounts


@contextlib.contextmanager
def _real(args: argparse.Namespace) -> Iterator[tuple[LoopTable, Callable[[], object]]]:
    """The table of the file: each mount with a supervisor, each camera with its scale; and what stops all mounts."""
    virtual_address(args)  # --profile without --virtual is an error
    with Table.open(patience_of(args), camera_settings(args)) as table, table.loop("beam loop") as loop:
        loop.take_control()
        yield loop, lambda: table.stop("STOP was pressed on the loop's page")


# ---- calibration


def _response(table: LoopTable, tell: Listen, path: Path | None) -> tuple[Response, Sequence[Gap] | None, bool]:
    """The saved calibration, or a new one; whether it is new."""
    if path and (response := load(path, table)):
        print(f"calibration of {response.measured} ({path})")
        return response, None, False
    print("there is no calibration yet: measuring it first")
    response, gaps = _calibrated(table, tell)
    if path:
        save(response, path)
    return response, gaps, True


def _calibrated(table: LoopTable, tell: Listen) -> tuple[Response, Sequence[Gap]]:
    """Measure, and show what was found: it is told even if it cannot be saved."""
    begin_s = table.now_s()
    measuring = Calibration(table, tell)
    response = measuring.run()
    print(f"calibrated in {table.now_s() - begin_s:.0f} s of the mounts' time")
    _tell_response(response)
    return response, measuring.gaps


def _keep(response: Response, path: Path | None, numbers: Path | None, result: dict[str, Any]) -> None:
    """Save the calibration, and write --json: each, even if the other one cannot be written. Raises CannotWrite."""
    try:
        if path:
            save(response, path)
    finally:
        write_numbers(numbers, result)


# ---- what is said


@contextlib.contextmanager
def told(args: argparse.Namespace, also: Listen | None) -> Iterator[Listen]:
    """What takes the loop's events: the line on the terminal, interlocks on stdout, and the log."""
    with contextlib.ExitStack() as stack:
        line = stack.enter_context(LoopLine())
        log: RunLog | None = None
        trouble = ""
        if args.log:
            log = stack.enter_context(RunLog(args.log, {"command": args.command}, patient=args.virtual))

        def tell(event: Event) -> None:
            nonlocal trouble
            if log:
                log(event)
                if log.trouble != trouble:
                    trouble = log.trouble
                    line.say(event, f"the log cannot be written: {trouble}; the loop goes on")
            if also:
                also(event)
            line(event)

        yield tell


def _tell_response(response: Response) -> None:
    for i, (name, *_) in enumerate(response.belongs["actuators"]):
        gaps = " and ".join(f"{response.widths[i][way].mean:.2f}" for way in (1, -1))
        um = ", ".join(f"{value:+.0f}" for value in response.matrices[1][:, i])
        print(f"{name}: a step moves the spots by {um} um; gap {gaps} steps")
    if promise := response.promise:
        rms = f"{promise.um:.0f} um rms" if promise.urad is None else f"{promise.urad:.1f} urad rms"
        print(f"this table will hold {rms}, by what was measured")
    else:
        print("this table will not be held, by what was measured: the spots drift, or the pulses scatter, too much")


def _tell_align(summary: Summary) -> None:
    um = "not known" if summary.last_um is None else f"{abs(summary.last_um).max():.1f} um"
    goal = "aligned" if summary.reached else "NOT aligned"
    print(f"{goal}: largest error {um} after {summary.corrections} corrections, {summary.seconds:.0f} s")


def _tell_hold(summary: Summary) -> None:
    rms = "angle not known" if summary.rms_urad is None else f"{summary.rms_urad:.1f} urad rms"
    promised = "" if not (summary.promise and summary.promise.urad) else f" (promised {summary.promise.urad:.1f})"
    goal = "held" if summary.reached else "NOT held as asked"
    print(
        f"{goal}: {rms}{promised}, largest error {summary.max_um:.0f} um, {summary.corrections} corrections,"
        f" {summary.reversals} reversals, {summary.actions} pulses in {summary.seconds:.0f} s"
    )


# ---- the file of --json


def check_numbers(path: Path | None) -> None:
    """Raises CannotWrite now, and not after hours of holding; also if a file is there that is no earlier run's."""
    if path and not _is_device(path):
        file = files.behind_link(path)
        files.check_replaceable(file, _NUMBERS_BEGIN)
        files.check_writable(file)


def write_numbers(path: Path | None, result: dict[str, Any]) -> None:
    """Write --json. Raises CannotWrite."""
    if path is None:
        return
    text = json.dumps(result, indent=1) + "\n"
    if not _is_device(path):
        files.write_atomic(files.behind_link(path), text)
        return
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as e:
        raise CannotWrite(f"{path}: {e.strerror or e}") from e


def _is_device(path: Path) -> bool:
    """True for what holds no content that could be lost: a device, a pipe. It is opened once."""
    return path.exists() and not (path.is_file() or path.is_dir())


# ---- the commands


def _common(parser: argparse.ArgumentParser, off: str) -> None:
    table_option(parser)
    virtual_options(parser, "the virtual table, as fast as it goes; no hardware needed")
    parser.add_argument("--mounts", choices=("1", "2"), default="2", help="virtual: how many (2)")
    parser.add_argument("--cameras", choices=("1", "2"), default="2", help="virtual: how many (2)")
    parser.add_argument("--off", metavar="MM", default=off, help=f"virtual: the beam begins so far off ({off})")
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="what calibrate measured (default: beside table.toml; virtual: none, measured anew)",
    )
    selection_options(parser)
    patience_option(parser, "the loop")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all figures of the run")
    parser.add_argument(
        "--log", type=Path, metavar="FILE", help="every observation and pulse, for `mirrormount report`"
    )


def _align_arguments(parser: argparse.ArgumentParser) -> None:
    _common(parser, "9")
    parser.add_argument("--within", metavar="UM", default="15", help="the goal on each camera (15)")
    parser.add_argument("--most", metavar="N", default="30", help="corrections at most (30)")
    signal = parser.add_argument_group("instead of spots on cameras, a signal that is brought to its maximum")
    signal.add_argument(
        "--signal",
        metavar="SOURCE",
        help="board, camera:NAME, scpi:PORT, serial:PORT, python:MODULE:FUNCTION; fibre (with --virtual)",
    )
    signal.add_argument("--axes", metavar="LIST", help="such as first.x,first.y (default: all of the mounts)")
    signal.add_argument("--limit", metavar="STEPS", default="40", help="no axis goes further from where it is (40)")
    signal.add_argument("--query", metavar="TEXT", help="what a meter is asked (scpi: MEAS:POW?; serial: nothing)")
    signal.add_argument("--baud", metavar="N", default="9600", help="of the meter's port (9600)")


def _hold_arguments(parser: argparse.ArgumentParser) -> None:
    _common(parser, "2")
    parser.add_argument("--duration", metavar="S", help="seconds (default: until Ctrl-C; virtual: 3600)")
    parser.add_argument(
        "--rms-urad", metavar="N", help="goal: rms of the beam's angle (1.5 times the promise; without one 9)"
    )
    parser.add_argument("--page", action="store_true", help="a page with pictures, errors, alarms, HOLD and STOP")
    web_options(parser)
    parser.add_argument("--max-um", metavar="N", default="120", help="goal: the largest error on a camera (120)")


def report_arguments(parser: argparse.ArgumentParser) -> None:
    """The log and the page."""
    parser.add_argument("log", type=Path, metavar="LOG", help="the file that `mirrormount hold --log` writes")
    parser.add_argument("--html", type=Path, metavar="FILE", help="the page (default: beside the log, as .html)")
    open_option(parser)


def run_report(args: argparse.Namespace) -> None:
    """Write the page, of a run that goes on as well. Raises BadFile, CannotWrite."""
    with from_extra("plot", "a report needs"):
        from mirrormount_beam.report import write_report
        from mirrormount_beam.runlog import read_run
    page = args.html or args.log.with_suffix(".html")
    write_report(page, read_run(args.log))
    tell_page(page, args.open)


COMMANDS = (
    Command(
        "calibrate",
        "measure what the mounts do to the beam",
        partial(run, "calibrate"),
        partial(_common, off="2"),
    ),
    Command("align", "bring the beam to its targets", partial(run, "align"), _align_arguments),
    Command("hold", "keep the beam at its targets", partial(run, "hold"), _hold_arguments),
    Command("report", "make the page of a run that held the beam, from its log", run_report, report_arguments),
)
