"""`mirrormount status`: identity, one line an axis, and the errors that wait in the board."""

import argparse

from mirrormount.cli.command import Command, open_any, port_options

_LIMITS = {0: "-", 1: "positive", 2: "negative", 3: "both"}


def run(args: argparse.Namespace) -> None:
    """Print them. The errors are taken from the board's queue."""
    from mirrormount.common.errors import REASONS
    from mirrormount.device.arduino_sketch import LIMITS, SketchMount

    with open_any(args) as mount:
        if isinstance(mount, SketchMount):
            print(LIMITS)
            return
        status = mount.status()
        print(mount.identity)
        for name, axis in status.by_name.items():
            print(
                f"{name}: {axis.position:+.3f} steps ({axis.certainty}),"
                f" {'moving' if axis.moving else 'at rest'}, last move: {REASONS.get(axis.reason, axis.reason)},"
                f" end-stops: {_LIMITS[axis.limits & 3]}"
            )
        for error in mount.take_errors():
            print(f"error {error}")


COMMAND = Command("status", "show what the board knows", run, port_options)
