"""`mirrormount report`: the page of a run, made from its log."""

import argparse
from pathlib import Path

from mirrormount.cli.command import Command, from_extra


def arguments(parser: argparse.ArgumentParser) -> None:
    """The log and the page."""
    parser.add_argument("log", type=Path, metavar="LOG", help="the file that `mirrormount hold --log` writes")
    parser.add_argument("--html", type=Path, metavar="FILE", help="the page (default: beside the log, as .html)")


def run(args: argparse.Namespace) -> None:
    """Write the page, of a run that goes on as well. Raises BadFile, CannotWrite."""
    with from_extra("camera,plot", "a report needs"):
        from mirrormount.beam.run_report import write_report
        from mirrormount.beam.runlog import read_run
    page = args.html or args.log.with_suffix(".html")
    write_report(page, read_run(args.log))
    print(page)


COMMANDS = (Command("report", "make the page of a run that held the beam, from its log", run, arguments),)
