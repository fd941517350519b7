"""`mirrormount keep`, `back`, `undo` and `log`: named positions, Zero undone, and what has moved."""

import argparse
import contextlib
import csv
import re
import sys
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from typing import Any, TextIO

from mirrormount.cli.arguments import (
    Command,
    axis_argument,
    camera_options,
    camera_settings,
    note,
    open_mount,
    port_options,
    said_yes,
    spot_of,
)
from mirrormount.device import motion_log
from mirrormount.device.motion_log import LoggedMotion
from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue, MountError
from mirrormount.values import did_you_mean

_SPAN = re.compile(r"([0-9]{1,6})([smhd])")
_UNITS = {"s": "seconds", "m": "minutes", "h": "hours", "d": "days"}
_DAYS = ("today", "yesterday")
_YES = "do not ask, even where it may be another place"


def keep_arguments(parser: argparse.ArgumentParser) -> None:
    """NAME, and what to do with it."""
    port_options(parser)
    parser.add_argument("name", nargs="?", metavar="NAME", help="without one the kept positions are listed")
    parser.add_argument("--list", action="store_true", help="list the kept positions of this board")
    parser.add_argument("--remove", action="store_true", help="forget that position")
    _camera(parser, "keep also where this camera sees the spot")


def keep(args: argparse.Namespace) -> None:
    """Keep, list or remove. Raises MountError."""
    if args.remove and (args.list or not args.name):
        raise BadValue("--remove needs a NAME, and no --list")
    if args.camera is not None and (args.remove or args.list or not args.name):
        raise BadValue("--camera is for a position that is kept now: it needs a NAME, and no --list or --remove")
    with open_mount(args) as mount:
        presets = mount.presets
        if args.remove:
            presets.remove(args.name)
            print(f"{args.name} is forgotten")
            return
        with _spot(mount, args) as spot:
            new = args.name and not args.list
            kept = [presets.keep(args.name, spot=spot and spot.seen())] if new else presets.all()
        names = {axis.number: axis.name for axis in mount.axes}
        for preset in kept:
            places = (
                f"{names.get(number, f'axis {number}')} {place.position:+.3f} ({place.certainty})"
                for number, place in preset.places.items()
            )
            print(f"{preset}: {', '.join(places)}" + (f"; {preset.spot}" if preset.spot else ""))
        if not kept:
            print("no position of this board is kept")


def back_arguments(parser: argparse.ArgumentParser) -> None:
    """NAME."""
    port_options(parser)
    parser.add_argument("name", nargs="?", metavar="NAME", help="default: the last one that was kept")
    parser.add_argument("--yes", action="store_true", help=_YES)
    _camera(parser, "then bring the spot to where this camera saw it")


def _camera(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument("--camera", metavar="CAMERA", help=f"{what} (as `mirrormount camera` takes it)")
    camera_options(parser)


def _spot(mount: Mount, args: argparse.Namespace) -> contextlib.AbstractContextManager[Any]:
    """The spot in the camera of the arguments; None without one. Raises as spot_of(), BadValue."""
    if args.camera is not None:
        return spot_of(mount, args)
    if given := camera_settings(args).given:
        raise BadValue(f"{', '.join(given)}: of a camera; add --camera")
    return contextlib.nullcontext()


def back(args: argparse.Namespace) -> None:
    """Go back to a position, and print it. Raises MountError."""
    from mirrormount.cli.motion import watched

    with open_mount(args) as mount, mount.unless_stopped(since_open=True), _spot(mount, args) as spot:
        preset = mount.presets.get(args.name)
        if spot:
            spot.check(preset)  # before anything moves
        if args.name is None:
            note(f"back to {preset}, the last position that was kept")
        sure = args.yes
        if not sure and (doubts := mount.presets.doubts(preset)):
            sure = said_yes(f"{'; '.join(doubts)}. Go all the same?")
        with watched(mount, mount.axes) as line:
            where_to = f"on the way to {preset.name}; Ctrl-C stops"
            mount.presets.back(preset.name, sure=sure, progress=lambda _: line.show(where_to))
            brought = ""
            try:
                if spot:
                    brought = spot.bring(preset, lambda text: line.show(f"{preset.name}: {text}; Ctrl-C stops"))
            except MountError:
                with contextlib.suppress(MountError):  # the board has gone: that error says it
                    note(
                        f"by steps it was back at {preset.name}; from there the camera's way ended at {_places(mount)}"
                    )
                raise
        print(f"{preset.name}: {_places(mount)}" + (f"; {brought}" if brought else ""))


def _places(mount: Mount) -> str:
    from mirrormount.cli.motion import place

    return ", ".join(f"{place(axis)} ({axis.status().certainty})" for axis in mount.by_name.values())


def undo_arguments(parser: argparse.ArgumentParser) -> None:
    """AXIS."""
    port_options(parser)
    axis_argument(parser, optional=True)
    parser.add_argument("--yes", action="store_true", help="also where the board was restarted or homed since")


def undo(args: argparse.Namespace) -> None:
    """Undo the last Zero. Raises MountError."""
    with open_mount(args) as mount:
        print(mount.presets.undo_zero(args.axis, sure=args.yes))
        if not args.axis and (zeroed := mount.presets.zeroed()):
            note(f"another Zero can be undone, if it was a mistake, too: mirrormount undo {' or '.join(zeroed)}")


def log_arguments(parser: argparse.ArgumentParser) -> None:
    """From when, of which board, and how it is printed."""
    parser.add_argument(
        "--since", metavar="WHEN", default="1d", help="30m, 1h, 2d, today, yesterday, or 2026-01-31[T18:00] (1d)"
    )
    parser.add_argument("--board", metavar="NAME", default="", help="only of this mount, or of the board of this id")
    parser.add_argument("--csv", action="store_true", help="as a table for other programs: oldest first, times in UTC")


def log(args: argparse.Namespace) -> None:
    """Print what has moved, newest first. Raises MountError."""
    from mirrormount.device import table_file

    names = table_file.mounts_by_axis()
    named = args.board in names.values()
    if args.board in table_file.read().mounts and not named:
        raise BadValue(f"{args.board} is named by its port, and the log has the ids of boards: give that of its board")
    motions = list(motion_log.read(since(args.since, datetime.now()).timestamp(), "" if named else args.board))
    if named:
        motions = [motion for motion in motions if names.get((motion.board.upper(), motion.axis)) == args.board]
    if not motions:
        meant = did_you_mean(args.board, set(names.values()))
        print(f"nothing that moved since then is logged on this computer{meant}", file=sys.stderr)
    if args.csv:
        write_csv(motions, sys.stdout)
        return
    for motion, what in reversed(list(in_words(motions))):
        at = datetime.fromtimestamp(motion.ended).astimezone().isoformat(" ", "seconds")
        print(f"{at}  {names.get((motion.board.upper(), motion.axis), motion.board)}  {what}, by {motion.who}")


def in_words(motions: Iterable[LoggedMotion]) -> Iterator[tuple[LoggedMotion, str]]:
    """Each motion, with what moved from where to where and how it ended; oldest first."""
    last: dict[tuple[str, int], float] = {}
    for motion in motions:
        was = last.get((motion.board, motion.axis), motion.from_steps)
        last[motion.board, motion.axis] = motion.to_steps
        gap = "" if abs(was - motion.from_steps) < 0.001 else f" (not logged: it was at {was:+.3f} before)"
        way = f"{motion.from_steps:+.3f} to {motion.to_steps:+.3f} steps"
        yield motion, f"{motion.name}: {way}{gap}, {motion.how} ({motion.certainty})"


def write_csv(motions: Iterable[LoggedMotion], file: TextIO) -> None:
    """Write motions as a table with a heading, times in UTC."""
    table = csv.writer(file, lineterminator="\n")
    table.writerow(motion_log.COLUMNS)
    for motion in motions:
        begun, ended = (datetime.fromtimestamp(t, UTC).isoformat("T", "milliseconds") for t in motion[:2])
        table.writerow([begun, ended, *motion[2:]])


def since(text: str, now: datetime) -> datetime:
    """The local time that --since names. Raises BadValue."""
    midnight = now.replace(hour=0, minute=0, second=0, microsecond=0)
    if text in _DAYS:
        return midnight - timedelta(days=text == "yesterday")
    try:
        if span := _SPAN.fullmatch(text):
            return now - timedelta(**{_UNITS[span[2]]: int(span[1])})
        return datetime.fromisoformat(text)
    except (ValueError, OverflowError):
        raise BadValue(
            f"--since is a time such as 30m, 1h, 2d, today, yesterday or 2026-01-31T18:00, not {text!r}"
            f"{did_you_mean(text, _DAYS)}"
        ) from None


COMMANDS = (
    Command("keep", "keep the position of all axes under NAME; without one list them", keep, keep_arguments),
    Command("back", "go back to the position NAME, or to the last one that was kept", back, back_arguments),
    Command("undo", "undo the last Zero: the coordinates from before, without motion", undo, undo_arguments),
    Command("log", "show what has moved, newest first: when, who, from where to where, its end", log, log_arguments),
)
