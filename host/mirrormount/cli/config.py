"""`mirrormount config`: its verbs, which config_verbs.py carries out."""

import argparse

from mirrormount.cli.command import Command, open_mount, port_options

_SAVE_HELP = "keep it, and all other present settings, on the board"


def arguments(parser: argparse.ArgumentParser) -> None:
    """The verbs, each with the port."""
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")

    def add(name: str, what: str) -> argparse.ArgumentParser:
        verb = verbs.add_parser(name, help=what, description=what)
        port_options(verb)
        return verb

    add("get", "show all settings, or one").add_argument("name", nargs="?", metavar="NAME", help="such as x.pulse_us")
    sub = add("set", "change one setting until the board restarts, or for good")
    sub.add_argument("name", metavar="NAME", help="such as x.pulse_us")
    sub.add_argument("value", metavar="VALUE")
    sub.add_argument("--save", action="store_true", help=_SAVE_HELP)
    add("save", "keep the present settings on the board")
    sub = add("restore", "go back to the saved settings")
    sub.add_argument("--factory", action="store_true", help="to those of a new board instead; saved ones stay saved")
    add("export", "write all settings to a TOML file").add_argument("file", metavar="FILE", help="- is standard output")
    sub = add("import", "take settings from a TOML file: all of them, or none")
    sub.add_argument("file", metavar="FILE", help="- is standard input")
    sub.add_argument("--save", action="store_true", help=_SAVE_HELP)


def run(args: argparse.Namespace) -> None:
    """Carry out the verb. Raises MountError; BadValue and BadFile before a port is opened."""
    from mirrormount.cli import config_verbs
    from mirrormount.common.signals import ended_in_order

    config_verbs.check_arguments(args)
    with ended_in_order(), open_mount(args) as mount:
        config_verbs.carry_out(mount, args)


COMMANDS = (Command("config", "show, change, save, export and import settings", run, arguments),)
