"""`mirrormount setup`: the course of questions of setup_course.py."""

import argparse

from mirrormount.cli.command import Command, open_mount, port_options


def run(args: argparse.Namespace) -> None:
    """Ask and move, and save at the end if the answer is yes. Raises MountError."""
    from mirrormount.cli.setup_course import run_course
    from mirrormount.common.signals import ended_in_order

    with ended_in_order(), open_mount(args) as mount:
        run_course(mount)


COMMANDS = (
    Command(
        "setup", "go through a new mount: directions, switches, scale and backlash, with questions", run, port_options
    ),
)
