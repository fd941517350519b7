"""`mirrormount ports` and `mirrormount status`: which boards are there, and what one of them reports."""

import argparse
from typing import TYPE_CHECKING

from mirrormount.cli.arguments import Command, no_arguments, open_mount, port_options

if TYPE_CHECKING:
    from mirrormount.device.axis import Axis


def list_ports(_args: argparse.Namespace) -> None:
    """Print one line a port."""
    from mirrormount.terminal import printable
    from mirrormount.transport.discovery import find

    found = find()
    for device, what in found:
        print(f"{printable(device)}  {printable(what)}")
    if not found:
        print("no board found; a virtual one is always there: --port virtual://")


_LIMITS = {0: "-", 1: "positive", 2: "negative", 3: "both"}


def show_status(args: argparse.Namespace) -> None:
    """Print them. The errors are taken from the board's queue."""
    from mirrormount.errors import REASONS

    with open_mount(args) as mount:
        status = mount.status()
        errors = mount.take_errors()  # before a question could empty their queue
        print(mount.identity)
        for name, axis in status.by_name.items():
            print(
                f"{name}: {axis.position:+.3f} steps ({axis.certainty}),"
                f" {'moving' if axis.moving else 'at rest'}, last move: {REASONS.get(axis.reason, axis.reason)},"
                f" end-stops: {_LIMITS[axis.limits & 3]}{_encoder(mount.by_name[name])}"
            )
        for error in errors:
            print(f"error {error}")


def _encoder(axis: "Axis") -> str:
    """Counts and loop, to follow a status; "" without an encoder."""
    from mirrormount.errors import EncoderFault

    if not axis.has_encoder:
        return ""
    per_step, closed = axis.ask_whole("XN?", "MM?")
    loop = f"closed loop, {abs(per_step)} counts a step" if closed else "open loop"
    try:
        return f", encoder: {axis.counts} counts ({loop})"
    except EncoderFault:
        return f", encoder: does not answer ({loop})"


COMMANDS = (
    Command("ports", "list the ports that a mount may be at", list_ports, no_arguments),
    Command("status", "show what the board knows", show_status, port_options),
)
