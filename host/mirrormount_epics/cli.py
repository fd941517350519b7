"""`mirrormount ioc`: mounts as EPICS motor records, for clients of Channel Access and PVAccess.

EPICS base is imported where it is started, so that the help of the command and its lists are quick.
"""

import argparse
import contextlib
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mirrormount import files
from mirrormount.cli.arguments import (
    Command,
    from_extra,
    patience_of,
    patience_option,
    port_options,
    virtual_address,
    virtual_options,
)
from mirrormount.device import table_file
from mirrormount.device.table_file import CameraEntry
from mirrormount.errors import AllowNeeded, BadFile, BadValue, ExtraMissing
from mirrormount.supervise.supervisor import Supervisor, supervised
from mirrormount.terminal import Terminated, ended_in_order
from mirrormount.transport.ports import open_table
from mirrormount_epics import fields
from mirrormount_epics.pump import PATIENCE_S, Pump
from mirrormount_epics.screen import screen

if TYPE_CHECKING:
    from mirrormount_epics.mount import Board

_LOOPBACK = "127.0.0.1"
_LONGEST_PREFIX = 17  # characters: a record's name has 60, of which a mount's has 31, and :x:certainty has 12
READ_ONLY = "ASG(DEFAULT) { RULE(1, READ) RULE(0, WRITE) }"  # level 0 is .STOP: everybody may stop
_AXES = ("x", "y")
_HANGS_S = 10

Cameras = dict[str, tuple[Callable[[], Any], CameraEntry]]  # by name: what opens it; what the table's file says of it


@dataclass(frozen=True)
class Mount:
    """A mount record. axes: the labels of its motor records, and the board's names of these axes."""

    name: str
    supervisor: Supervisor
    axes: Mapping[str, str]


def arguments(parser: argparse.ArgumentParser) -> None:
    """Which mounts, under which names, and who may write."""
    parser.add_argument(
        "at", nargs="*", metavar="PORT", help="serial ports, or mounts' names (default: all of the table)"
    )
    port_options(parser)
    virtual_options(parser, "a virtual board; no hardware needed")
    parser.add_argument("--cameras", choices=("0", "1", "2"), default="0", help="virtual: of the virtual table (0)")
    patience_option(parser, "the IOC", PATIENCE_S)
    parser.add_argument("--prefix", default="", metavar="P", help="in front of each record's name, such as LAB:")
    parser.add_argument(
        "--host", default=_LOOPBACK, help="on which address to listen; others need --acf or --read-only"
    )
    parser.add_argument("--read-only", action="store_true", help="clients may stop, and write nothing else")
    parser.add_argument("--acf", type=Path, metavar="FILE", help="who may write: EPICS's file of access security")
    parser.add_argument("--no-pva", dest="pva", action="store_false", help="serve Channel Access only")
    parser.add_argument("--list", action="store_true", help="print every record and field with its meaning, and end")
    parser.add_argument("--screen", type=Path, metavar="FILE", help="write a screen for Phoebus (.bob), and end")


def run(args: argparse.Namespace) -> None:
    """Serve until a signal ends it. Raises MountError."""
    rules = _rules(args)
    _check_prefix(args.prefix)
    with contextlib.suppress(Terminated), ended_in_order(), contextlib.ExitStack() as opened:  # a signal is its end
        mounts, cameras = _table(args, opened)
        names = {args.prefix + mount.name: tuple(mount.axes) for mount in mounts}
        linked = {args.prefix + name: "camera" for name in cameras}
        if cameras:
            linked[args.prefix + fields.LOOP_NAME] = "loop"
        if args.list:
            print("\n".join(fields.listed(names, linked)))
        elif args.screen:
            files.write_atomic(args.screen, screen(names, linked))
        else:
            _serve(args, mounts, cameras, rules, opened)


def _check_prefix(prefix: str) -> None:
    if len(prefix) > _LONGEST_PREFIX or not all(one.isascii() and (one.isalnum() or one in "_-:") for one in prefix):
        raise BadValue(f"--prefix is at most {_LONGEST_PREFIX} letters, digits, _, - and :, not {prefix[:60]!r}")


def _rules(args: argparse.Namespace) -> str | None:
    """The rules of access security; None: whoever reaches it may write. Raises AllowNeeded, BadValue, BadFile."""
    if args.read_only and args.acf:
        raise BadValue("--read-only and --acf: one of them")
    if args.acf:
        try:
            return args.acf.read_text("utf-8")
        except (OSError, UnicodeDecodeError) as e:
            raise BadFile(f"{args.acf}: {getattr(e, 'strerror', None) or 'not a text file'}") from e
    if args.read_only:
        return READ_ONLY
    if args.host != _LOOPBACK and not args.list and not args.screen:
        raise AllowNeeded(
            f"{args.host} is more than this computer, and whoever reaches it could drive the mounts: say who may,"
            " --acf FILE, or --read-only; or listen on 127.0.0.1"
        )
    return None


def _table(args: argparse.Namespace, opened: contextlib.ExitStack) -> tuple[list[Mount], Cameras]:
    """The mounts and cameras, not open yet. Raises BadAddress, BadFile, BadValue, ExtraMissing."""
    if args.virtual and args.at:
        raise BadValue("--virtual is a board of its own: leave the port out")
    patience_s = patience_of(args)
    if args.cameras != "0":
        address = virtual_address(args, "virtual-table", mounts="1", cameras=args.cameras, speed="1")
        if address is None:
            raise BadValue("--cameras: of a virtual table; add --virtual, or name cameras in the table's file")
        virtual_table = opened.enter_context(contextlib.closing(open_table(address)))
        return [_mount("m1", lambda: virtual_table.ports[0], patience_s)], {
            f"c{i}": (partial(virtual_table.cameras.__getitem__, i - 1), CameraEntry("", 1000 * camera.distance_m))
            for i, camera in enumerate(virtual_table.cameras, 1)
        }
    virtual = virtual_address(args)
    named: list[str | None] = [virtual] if virtual else args.at or ([args.port] if args.port else [])
    table = table_file.read()
    if not named and table.mounts:
        of_table = supervised(table.mounts, patience_s)
        mounts = [Mount(name, board, dict(zip(_AXES, axes, strict=True))) for name, (board, axes) in of_table.items()]
        return mounts, _cameras(table.cameras)
    names = [port if port and port in table.mounts else f"m{i}" for i, port in enumerate(named or [None], 1)]
    return [_mount(name, port, patience_s) for name, port in zip(names, named or [None], strict=True)], {}


def _mount(name: str, address: Any, patience_s: float) -> Mount:
    return Mount(name, Supervisor(address, patience_s=patience_s), dict(zip(_AXES, _AXES, strict=True)))


def _cameras(entries: Mapping[str, CameraEntry]) -> Cameras:
    """Those of the table's file; none, with a warning, without the extra that they need."""
    try:
        with from_extra("beam", "the cameras of the table need"):
            from mirrormount_beam.cameras import open_camera
    except ExtraMissing as e:
        if entries:
            print(f"mirrormount: warning: {e}", file=sys.stderr)
        return {}
    return {
        name: (partial(open_camera, entry.camera, settings=entry.settings), entry) for name, entry in entries.items()
    }


def _serve(
    args: argparse.Namespace, mounts: list[Mount], cameras: Cameras, rules: str | None, opened: contextlib.ExitStack
) -> None:
    """opened: is closed here, because the process ends here."""
    from mirrormount_epics import base
    from mirrormount_epics.motor import Motor
    from mirrormount_epics.mount import Board, MountRecord, saver

    pump = Pump()
    motors: dict[str, tuple[Motor, base.Record]] = {}
    records: dict[str, MountRecord] = {}

    def make_motor(record: base.Record) -> Motor:
        motors[record.name] = Motor(record.name, record), record
        return motors[record.name][0]

    def make_mount(record: base.Record) -> MountRecord:
        records[record.name] = MountRecord(record)
        return records[record.name]

    supervisors = dict.fromkeys(mount.supervisor for mount in mounts)
    with opened:
        for supervisor in supervisors:
            opened.enter_context(contextlib.closing(supervisor.open(absent=len(mounts) > 1)))
            trouble = supervisor.worker.connection.trouble
            if trouble:
                print(f"mirrormount: warning: {trouble}", file=sys.stderr)
        base.start_database()
        types = fields.record_types()
        base.RecordType("motor", types["motor"], make_motor)
        base.RecordType("mount", types["mount"], make_mount)
        base.load("".join(fields.records(args.prefix + mount.name, tuple(mount.axes)) for mount in mounts))
        table = None
        if cameras:
            from mirrormount_epics.table import TableRecords

            table = opened.enter_context(contextlib.closing(TableRecords(args.prefix, cameras)))
        base.serve(args.host, rules, pva=args.pva)
        boards = []
        for supervisor in supervisors:
            own = [mount for mount in mounts if mount.supervisor is supervisor]
            boards.append(
                Board(
                    supervisor,
                    pump,
                    [records[args.prefix + mount.name] for mount in own],
                    {
                        axis: motors[f"{args.prefix}{mount.name}:{label}"]
                        for mount in own
                        for label, axis in mount.axes.items()
                    },
                )
            )
        if table:
            by_supervisor = {board.supervisor: board for board in boards}
            of_names = {
                mount.name: (by_supervisor[mount.supervisor], (mount.axes["x"], mount.axes["y"])) for mount in mounts
            }
            table.attach(pump, of_names)
        pump.seldom.append(saver(boards))
        pump.often.append(_once_ready(boards, [args.prefix + mount.name for mount in mounts]))
        threading.Thread(target=_end_if_it_hangs, args=(pump, base.leave), name="watchdog", daemon=True).start()
        status = _until_signal(pump)
    base.leave(status)


def _end_if_it_hangs(pump: Pump, leave: Callable[[int], None]) -> None:
    """End a process that no client can use any more; systemd starts it again.

    EPICS base's server of PVAccess locks a record for ever if a client puts to a read-only field, and waits. What moves
    has been stopped by then, for want of signs of life.
    """
    silent = 0
    while silent < _HANGS_S:
        beats = pump.beats
        time.sleep(1)
        silent = 0 if pump.beats != beats else silent + 1
    print(
        "mirrormount: a record is locked, so this IOC ends: start it again. A client of PVAccess does that by a put to"
        " a read-only field and waits; --no-pva leaves PVAccess out",
        file=sys.stderr,
    )
    leave(1)


def _until_signal(pump: Pump) -> int:
    """Run the pump. Returns the exit status."""
    try:
        pump.run()
    except Terminated:
        return 0
    except KeyboardInterrupt:
        print("mirrormount: stopped", file=sys.stderr)
    return 130


def _once_ready(boards: "list[Board]", names: list[str]) -> Callable[[], None]:
    """What prints one line when clients may come: every board that was there at the start is on its records."""
    told = []

    def tell() -> None:
        if not told and all(board.connected or not board.supervisor.worker.mount for board in boards):
            told.append(True)
            print(f"ready {' '.join(names)}", flush=True)

    return tell


COMMANDS = (
    Command(
        "ioc", "put mounts into EPICS as motor records, until Ctrl-C (Channel Access and PVAccess)", run, arguments
    ),
)
