"""`mirrormount scan raster | spiral | line | find`, by scan_work.py."""

import argparse
from pathlib import Path

from mirrormount.cli.command import Command, from_extra, mount_and_camera

SIGNALS = ("spot", "grey")


def arguments(parser: argparse.ArgumentParser) -> None:
    """The pattern; mount, camera and signal; the files."""
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="PATTERN")
    raster = verbs.add_parser("raster", help="rows about the start, each run to the right, from the lowest up")
    raster.add_argument("columns", metavar="COLUMNS")
    raster.add_argument("rows", metavar="ROWS")
    raster.add_argument("--serpentine", action="store_true", help="run every second row to the left")
    raster.add_argument("--approach", metavar="N", help="steps that a row begins beyond its first place (4)")
    spiral = verbs.add_parser("spiral", help="a square spiral from the start outwards")
    spiral.add_argument("rings", metavar="RINGS", help="how many turns around the start")
    line = verbs.add_parser("line", help="places in a line from the start on")
    line.add_argument("by_x", metavar="BY_X", help="steps of x from a place to the next")
    line.add_argument("by_y", metavar="BY_Y", help="the same of y")
    line.add_argument("count", metavar="COUNT", help="how many places")
    find = verbs.add_parser("find", help="a spiral that ends where the camera sees the beam")
    find.add_argument("rings", metavar="RINGS", nargs="?", default="10", help="how far it searches (10)")
    for verb in (raster, spiral, find):
        verb.add_argument("--pitch", metavar="N", default="1", help="steps between places (1)")
    for verb in (raster, spiral, line):
        verb.add_argument(
            "--signal", choices=SIGNALS, default="spot", help="the spot (default), or the mean grey value"
        )
        verb.add_argument("--back", action="store_true", help="return to the start at the end")
    for verb in (raster, spiral, line, find):
        _common(verb)


def _common(parser: argparse.ArgumentParser) -> None:
    mount_and_camera(parser)
    parser.add_argument("--page", type=Path, metavar="FILE", help="a live picture: open this HTML file in a browser")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="a new file, written row by row")
    parser.add_argument("--hdf5", type=Path, metavar="FILE", help="a new file, written at the end")


def run(args: argparse.Namespace) -> int:
    """Scan; the exit status. Raises MountError."""
    with from_extra("camera", "a scan with a camera needs"):
        from mirrormount.cli import scan_work
    return scan_work.work(args)


COMMANDS = (Command("scan", "visit places with the mount and read a camera at each; find a lost beam", run, arguments),)
