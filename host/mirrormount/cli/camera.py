"""`mirrormount camera list | show | record | scale`, by camera_work.py and camera_scale.py."""

import argparse
import os
from pathlib import Path

from mirrormount.cli.command import Command, from_extra, virtual_address, virtual_camera, virtual_options, web_options


def arguments(parser: argparse.ArgumentParser) -> None:
    """The verb, and which camera."""
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    verbs.add_parser("list", help="the cameras of this computer")
    show = verbs.add_parser("show", help="where the spot is in each frame, or why there is none, until Ctrl-C")
    _camera(show)
    show.add_argument("--dark", type=Path, metavar="FILE", help="a picture without the beam, for the hot pixels")
    show.add_argument("--page", action="store_true", help="show it on a page in the browser")
    web_options(show)
    record = verbs.add_parser("record", help="write frames into a new folder, lossless, with their times")
    record.add_argument("folder", type=Path, metavar="FOLDER")
    _camera(record)
    for each in (show, record):
        each.add_argument("--frames", metavar="N", help="end after so many")
    _scale(verbs.add_parser("scale", help="mm per pixel, distance and angle of incidence of a camera, saved for later"))


def _scale(parser: argparse.ArgumentParser) -> None:
    """From what the scale comes; each source has its numbers, and all have what follows."""
    sources = parser.add_subparsers(dest="source", required=True, metavar="SOURCE")
    ruler = sources.add_parser("ruler", help="two points in the picture, and the mm between them")
    for name in ("x1", "y1", "x2", "y2"):
        ruler.add_argument(name, metavar=name.upper(), help="pixels from the top left")
    ruler.add_argument("length", metavar="MM", help="from the first point to the second one")
    board = sources.add_parser("checkerboard", help="a printed checkerboard in the picture")
    board.add_argument("columns", metavar="COLUMNS", help="inner corners along a row: squares less one")
    board.add_argument("rows", metavar="ROWS", help="rows of inner corners")
    board.add_argument("square", metavar="MM", help="side of a square")
    pitch = sources.add_parser("pitch", help="a sensor without a lens: distance of its pixels")
    pitch.add_argument("pitch", metavar="UM", help="um, from the sensor's data sheet")
    geometry = sources.add_parser("geometry", help="only the distance or the angle of incidence; mm per pixel stays")
    _camera(sources.add_parser("show", help="the saved scale"))
    for source in (ruler, board, pitch):
        source.add_argument("--error", metavar="E", help="standard error of the length, in its unit (0)")
    for source in (ruler, board, pitch, geometry):
        _camera(source)
        source.add_argument("--distance", metavar="MM", help="from the mirror to the screen, along the beam")
        source.add_argument("--distance-error", metavar="MM", help="its standard error (0)")
        source.add_argument(
            "--incidence",
            metavar="DEGREES",
            help="between beam and mirror's normal (default: as saved before, else not known)",
        )
        source.add_argument("--incidence-error", metavar="DEGREES", help="its standard error (0)")


def _camera(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--camera",
        help="index, device, part of a name, folder, or virtual-table:// (default: $MIRRORMOUNT_CAMERA, else 0);"
        " with --virtual: 1 or 2",
    )
    virtual_options(parser, "a camera of the virtual table of `measure` and `scan`; no hardware needed")


def run(args: argparse.Namespace) -> None:
    """List, show, record, or save a scale. Raises MountError."""
    with from_extra("camera", "cameras need"):
        from mirrormount.cli import camera_scale, camera_work
    if args.verb != "list":
        args.camera = _address(args)
    work = camera_scale.scale if args.verb == "scale" else getattr(camera_work, args.verb)
    work(args)


def _address(args: argparse.Namespace) -> str:
    """The address of the camera. Raises BadValue."""
    table = virtual_address(args, "virtual-table", mounts="1", cameras="2")
    if table is None:
        return os.environ.get("MIRRORMOUNT_CAMERA", "0") if args.camera is None else args.camera
    return f"{table}#{virtual_camera(args.camera)}"


COMMANDS = (Command("camera", "list cameras, show the spot, record frames, save a scale", run, arguments),)
