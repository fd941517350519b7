"""`mirrormount calibrate`, `align`, `hold`: measure what the mounts do to the beam, align it, keep it. hold_work.py."""

import argparse
from pathlib import Path

from mirrormount.cli.command import Command, from_extra, patience_option, table_option, virtual_options, web_options


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
    patience_option(parser, "the loop")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all figures of the run")
    parser.add_argument(
        "--log", type=Path, metavar="FILE", help="every observation and pulse, for `mirrormount report`"
    )


def _calibrate_arguments(parser: argparse.ArgumentParser) -> None:
    _common(parser, "2")


def _align_arguments(parser: argparse.ArgumentParser) -> None:
    _common(parser, "9")
    parser.add_argument("--within", metavar="UM", default="15", help="the goal on each camera (15)")
    parser.add_argument("--most", metavar="N", default="10", help="corrections at most (10)")


def _hold_arguments(parser: argparse.ArgumentParser) -> None:
    _common(parser, "2")
    parser.add_argument("--duration", metavar="S", help="seconds (default: until Ctrl-C; virtual: 3600)")
    parser.add_argument("--rms-urad", metavar="N", default="9", help="goal: rms of the beam's angle (9)")
    parser.add_argument("--page", action="store_true", help="a page with pictures, errors, alarms, HOLD and STOP")
    web_options(parser)
    parser.add_argument("--max-um", metavar="N", default="80", help="goal: the largest error on a camera (80)")


def _run(verb: str, args: argparse.Namespace) -> int:
    with from_extra("camera", f"`mirrormount {verb}` needs"):
        from mirrormount.cli import hold_work
    return hold_work.work(verb, args)


COMMANDS = (
    Command(
        "calibrate",
        "measure what the mounts do to the beam",
        lambda args: _run("calibrate", args),
        _calibrate_arguments,
    ),
    Command("align", "bring the beam to its targets", lambda args: _run("align", args), _align_arguments),
    Command("hold", "keep the beam at its targets", lambda args: _run("hold", args), _hold_arguments),
)
