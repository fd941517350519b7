"""The work of `mirrormount calibrate | align | hold`: table, calibration, loop, files, and what is said of them."""

import argparse
import contextlib
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mirrormount.beam.control.backlash import Gap
from mirrormount.beam.control.calibrate import Calibration, check_controllable
from mirrormount.beam.control.events import Event, InterlockCleared, InterlockTripped, Listen, Progress, StateChanged
from mirrormount.beam.control.hold import Hold, Summary, align
from mirrormount.beam.control.interfaces import LoopTable
from mirrormount.beam.control.response import Response, check_place, load, save
from mirrormount.beam.runlog import RunLog
from mirrormount.beam.table import LocalTable, Table, TargetCamera
from mirrormount.cli.command import from_extra, number, patience_of, positive, virtual_address, whole
from mirrormount.common import whole_file
from mirrormount.common.errors import BadValue, CannotWrite
from mirrormount.common.progress import StatusLine
from mirrormount.common.signals import ended_in_order
from mirrormount.device import calibration
from mirrormount.device.mount import Mount
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_table

if TYPE_CHECKING:
    from mirrormount.cli.hold_page import HoldPage

_NUMBERS_BEGIN = '{\n "reached": '  # the file of --json
_VIRTUAL_S = 3600.0  # of a virtual hold, unless another duration is asked for


def work(verb: str, args: argparse.Namespace) -> int:
    """Run one of the three; the exit status: 0 only if the goal was met. Raises MountError."""
    goals = _goals(verb, args)
    _check_numbers(args.json)
    path = args.calibration or (None if args.virtual else calibration.path().with_name("table-calibration.json"))
    if path:
        check_place(path)
    with ended_in_order(), contextlib.ExitStack() as stack:
        table, halt = stack.enter_context(_virtual(args) if args.virtual else _real(args))
        check_controllable(table)
        page = stack.enter_context(_page(args, table, halt)) if verb == "hold" and args.page else None
        tell = stack.enter_context(_told(args, page.board.listen if page else None))
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
        goals = positive(args.rms_urad, "--rms-urad"), positive(args.max_um, "--max-um")
        return {"seconds": seconds, "rms_urad": goals[0], "most_um": goals[1]}
    return {}


# ---- tables


@contextlib.contextmanager
def _virtual(args: argparse.Namespace) -> Iterator[tuple[LoopTable, None]]:
    """The virtual table in lockstep, its mounts driven from here."""
    address = virtual_address(args, "virtual-table", mounts=args.mounts, cameras=args.cameras, off=args.off)
    assert address is not None
    with contextlib.closing(open_table(address)) as table, contextlib.ExitStack() as stack:
        names = ("first", "second")[: int(args.mounts)]
        mounts = {name: stack.enter_context(Mount(Link(port))) for name, port in zip(names, table.ports, strict=True)}
        um = 1000 * table.cameras[0].scale.mm_per_px
        distances_m = [camera.distance_m for camera in table.cameras]
        cameras = [
            TargetCamera(
                camera.name, camera, ((camera.size.width - 1) / 2, (camera.size.height - 1) / 2), (um, um), at_m
            )
            for camera, at_m in zip(table.cameras, distances_m, strict=True)
        ]
        yield LocalTable(mounts, cameras, table.now_s, table.sleep), None


@contextlib.contextmanager
def _real(args: argparse.Namespace) -> Iterator[tuple[LoopTable, Callable[[], object]]]:
    """The table of the file: each mount with a supervisor, each camera with its scale; and what stops all mounts."""
    virtual_address(args)  # --profile without --virtual is an error
    with Table.open(patience_of(args)) as table, table.loop("beam loop") as loop:
        loop.take_control()
        yield loop, lambda: table.stop("STOP was pressed on the loop's page")


def _page(
    args: argparse.Namespace, table: LoopTable, halt: Callable[[], object] | None
) -> contextlib.AbstractContextManager["HoldPage"]:
    """The page of --page. Raises ExtraMissing."""
    with from_extra("gui", "a page needs"):
        from mirrormount.cli import hold_page
    return hold_page.served(args, table, halt)


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
        _write(numbers, result)


# ---- what is said


@contextlib.contextmanager
def _told(args: argparse.Namespace, also: Listen | None) -> Iterator[Listen]:
    """What takes the loop's events: the line on the terminal, interlocks on stdout, and the log."""
    line = StatusLine()
    with contextlib.ExitStack() as stack:
        stack.callback(line.end)
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
                    line.end()
                    print(f"{event.time_s:.1f} s: the log cannot be written: {trouble}; the loop goes on")
            if also:
                also(event)
            match event:
                case InterlockTripped():
                    line.end()
                    name = f"interlock {event.number}, {event.name}"
                    print(f"{event.time_s:.1f} s: {name}: {event.cause}; {event.remedy}")
                case InterlockCleared():
                    line.end()
                    print(f"{event.time_s:.1f} s: interlock {event.number}, {event.name}, is cleared; the loop goes on")
                case StateChanged():
                    line.show(f"{event.time_s:8.1f} s  {event.state}: {event.why}"[:110])
                case Progress():
                    line.show(f"{event.done:4.0%}  {event.what}")
                case _:
                    pass

        yield tell


def _tell_response(response: Response) -> None:
    for i, (name, *_) in enumerate(response.belongs["actuators"]):
        gaps = " and ".join(f"{response.widths[i][way].mean:.2f}" for way in (1, -1))
        um = ", ".join(f"{value:+.0f}" for value in response.matrices[1][:, i])
        print(f"{name}: a step moves the spots by {um} um; gap {gaps} steps")


def _tell_align(summary: Summary) -> None:
    um = "not known" if summary.last_um is None else f"{abs(summary.last_um).max():.1f} um"
    goal = "aligned" if summary.reached else "NOT aligned"
    print(f"{goal}: largest error {um} after {summary.corrections} corrections, {summary.seconds:.0f} s")


def _tell_hold(summary: Summary) -> None:
    rms = "angle not known" if summary.rms_urad is None else f"{summary.rms_urad:.1f} urad rms"
    goal = "held" if summary.reached else "NOT held as asked"
    print(
        f"{goal}: {rms}, largest error {summary.max_um:.0f} um, {summary.corrections} corrections,"
        f" {summary.reversals} reversals, {summary.actions} pulses in {summary.seconds:.0f} s"
    )


def _check_numbers(path: Path | None) -> None:
    """Raises CannotWrite now, and not after hours of holding; also if a file is there that is no earlier run's."""
    if path and not _is_device(path):
        file = whole_file.behind(path)
        whole_file.check_replaceable(file, _NUMBERS_BEGIN)
        whole_file.check_writable(file)


def _write(path: Path | None, result: dict[str, Any]) -> None:
    """Write --json. Raises CannotWrite."""
    if path is None:
        return
    text = json.dumps(result, indent=1) + "\n"
    if not _is_device(path):
        whole_file.write(whole_file.behind(path), text)
        return
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as e:
        raise CannotWrite(f"{path}: {e.strerror or e}") from e


def _is_device(path: Path) -> bool:
    """True for what holds no content that could be lost: a device, a pipe. It is opened once."""
    return path.exists() and not (path.is_file() or path.is_dir())
