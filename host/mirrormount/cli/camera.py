"""`mirrormount camera list | show | record`, by camera_work.py."""

import argparse
import os
from pathlib import Path

from mirrormount.cli.command import Command, from_extra


def arguments(parser: argparse.ArgumentParser) -> None:
    """The verb, and which camera."""
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    verbs.add_parser("list", help="the cameras of this computer")
    show = verbs.add_parser("show", help="where the spot is in each frame, or why there is none, until Ctrl-C")
    _camera(show)
    show.add_argument("--dark", type=Path, metavar="FILE", help="a picture without the beam, for the hot pixels")
    record = verbs.add_parser("record", help="write frames into a new folder, lossless, with their times")
    record.add_argument("folder", type=Path, metavar="FOLDER")
    _camera(record)


def _camera(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--camera",
        default=os.environ.get("MIRRORMOUNT_CAMERA", "0"),
        help="index, device, part of a name, folder, or virtual-table:// (default: $MIRRORMOUNT_CAMERA, else 0)",
    )
    parser.add_argument("--frames", metavar="N", help="end after so many")


def run(args: argparse.Namespace) -> None:
    """List, show or record. Raises MountError."""
    with from_extra("camera", "cameras need"):
        from mirrormount.cli import camera_work
    getattr(camera_work, args.verb)(args)


COMMAND = Command("camera", "list cameras, show the spot, record frames", run, arguments)
