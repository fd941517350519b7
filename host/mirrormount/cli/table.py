"""`mirrormount table`: the names of mounts and cameras, by table_work.py."""

import argparse

from mirrormount.cli.command import Command, table_option


def arguments(parser: argparse.ArgumentParser) -> None:
    """The verb; without one the table is listed."""
    table_option(parser)
    verbs = parser.add_subparsers(dest="verb", metavar="VERB")
    verbs.add_parser("list", help="what is there, and what is missing (the default)")
    mount = verbs.add_parser("mount", help="give a mount a name, or change what is known of it")
    mount.add_argument("name", metavar="NAME")
    mount.add_argument("at", nargs="?", metavar="PORT", help="where it is now (default: the only board)")
    mount.add_argument("--x-axis", metavar="N", help="the board's axis that is x (2)")
    mount.add_argument("--distance", metavar="MM", help="along the beam, from the mirror before")
    camera = verbs.add_parser("camera", help="give a camera a name, or change what is known of it")
    camera.add_argument("name", metavar="NAME")
    camera.add_argument("camera", nargs="?", metavar="CAMERA", help="as --camera takes it: an index, a part of a name")
    camera.add_argument("--target", nargs=2, metavar=("X", "Y"), help="where the spot belongs, in pixels")
    camera.add_argument("--distance", metavar="MM", help="along the beam, from the last mirror")
    verbs.add_parser("remove", help="forget a name").add_argument("name", metavar="NAME")


def run(args: argparse.Namespace) -> int | None:
    """List, add or remove. Raises MountError."""
    from mirrormount.cli import table_work

    return getattr(table_work, args.verb or "list")(args)


COMMANDS = (Command("table", "name the mounts and cameras of an optical table; list what is there", run, arguments),)
