"""`mirrormount config`: the settings of a board, shown, changed, saved on the board, kept in a file."""

import argparse
import re
import sys
from pathlib import Path
from typing import Any

from mirrormount import files
from mirrormount.cli.arguments import Command, note, open_mount, port_options
from mirrormount.device.mount import Mount
from mirrormount.device.settings import ENCODER, SETTINGS, Setting, check, setting
from mirrormount.device.table_file import find_port
from mirrormount.errors import BadFile, BadValue, NotSupported
from mirrormount.terminal import ended_in_order
from mirrormount.values import typed_number

_LASTS = "until the board restarts; to keep it: mirrormount config save"
_SAVED = "saved on the board"
_GONE = "; it is a virtual board that ends with this command: virtual://?files=FOLDER keeps what it saves"
_KEEPS = re.compile(r"[?&](files|flash)=")  # in the address of a virtual board
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
    sub = add("undo", "put the settings back that the last change of this computer has replaced")
    sub.add_argument("--save", action="store_true", help=_SAVE_HELP)
    add("export", "write all settings to a TOML file").add_argument("file", metavar="FILE", help="- is standard output")
    sub = add("import", "take settings from a TOML file: all of them, or none")
    sub.add_argument("file", metavar="FILE", help="- is standard input")
    sub.add_argument("--save", action="store_true", help=_SAVE_HELP)


def run(args: argparse.Namespace) -> None:
    """Carry out the verb. Raises MountError; BadValue and BadFile before a port is opened."""
    check_arguments(args)
    with ended_in_order(), open_mount(args) as mount:
        carry_out(mount, args)


# ---- the verbs


def carry_out(mount: Mount, args: argparse.Namespace) -> None:
    """Carry out the verb of the command line. Raises MountError."""
    saved = _saved(mount, args.port)
    if args.verb == "get":
        get(mount, args.name)
    elif args.verb == "set":
        axis, _, name = args.name.partition(".")
        value = number(args.name, args.value)
        mount.apply({axis: {name: value}})
        print(f"{args.name} = {value} ({_kept(mount, args.save, saved)})")
    elif args.verb == "save":
        print(_kept(mount, True, saved))
    elif args.verb == "restore":
        mount.recall(factory=args.factory)
        print("the factory's settings are in use" if args.factory else "the saved settings are in use")
    elif args.verb == "undo":
        for name, value in mount.undo_settings().items():
            print(f"{name} = {value}")
        print(f"the settings from before are back ({_kept(mount, args.save, saved)})")
    elif args.verb == "export":
        export(mount, args.file)
    else:
        import_(mount, args.wanted, save=args.save, saved=saved)


def get(mount: Mount, name: str | None) -> None:
    """Print one setting's value, or all settings with what they are."""
    values = mount.settings()
    if name is not None:
        axis, _, rest = name.partition(".")
        mount.axis(axis)  # raises BadValue for one that this board has not
        if rest not in values[axis]:
            raise NotSupported(f"{name}: the board says that {axis} has no encoder")
        print(values[axis][rest])
        return
    for axis, named in values.items():
        for rest, value in named.items():
            print(f"{f'{axis}.{rest} = {value}':28}# {SETTINGS[rest].what}")


def export(mount: Mount, name: str) -> None:
    """Write all settings to a file that import takes, or to standard output."""
    text = files.toml_text(mount.settings(), f"mirrormount settings of {mount.identity}")
    if name == "-":
        print(text, end="")
    else:
        files.write_atomic(Path(name), text)
        print(f"settings written to {name}")


def import_(mount: Mount, wanted: dict[str, Any], *, save: bool = False, saved: str = _SAVED) -> None:
    """Take settings that load() has read: all of them, or none. Raises BadValue."""
    mount.apply(wanted)
    print(f"{sum(map(len, wanted.values()))} settings taken ({_kept(mount, save, saved)})")


def load(name: str) -> dict[str, Any]:
    """The settings of a file (- is standard input), each of them possible. Raises BadFile."""
    if name == "-":
        try:
            given = sys.stdin.read(files.MOST_TOML) if sys.stdin else ""
        except UnicodeDecodeError as e:
            raise BadFile(f"standard input: not a text (byte {e.start})") from e
        name, tables = "standard input", files.parse_toml(given, "standard input")
    else:
        if not Path(name).exists():
            raise BadFile(f"{name}: there is no such file")
        if Path(name).is_fifo():
            note(f"{name} is a pipe: waiting for what another program writes into it; Ctrl-C ends that")
        tables = files.read_toml(Path(name))
    if not tables:
        raise BadFile(f"{name}: no settings in it: a table [x] or [y] is missing")
    try:
        check(tables)
    except BadValue as e:
        raise BadFile(f"{name}: {e}") from e
    return tables


def check_arguments(args: argparse.Namespace) -> None:
    """Find out before a port is opened that something cannot be. Raises BadValue, BadFile.

    The settings to import are args.wanted from then on: a pipe can be read only once.
    """
    if getattr(args, "file", None) == "":
        raise BadValue("FILE is an empty text: name a file, or - for standard input and output")
    name = getattr(args, "name", None)
    if name is not None:
        known = _setting(name)
        if args.verb == "set":
            known.check(name, number(name, args.value))
    elif args.verb == "import":
        args.wanted = load(args.file)


def number(name: str, text: str) -> int | float:
    """A value of a setting as it was typed. Raises BadValue."""
    try:
        if "e" in text.lower():
            raise ValueError
        value = typed_number(text, name)
        return value if "." in text else int(text)
    except ValueError:
        whole = _setting(name).decimals == 0
        kind = "a whole number, such as 1000" if whole else "a number, such as 1.5"
        raise BadValue(f"{name} is {kind}, without an exponent, not {text!r}") from None


def _kept(mount: Mount, save: bool, saved: str) -> str:
    """Save if that is wanted. Returns for how long the settings last. Ctrl-C says that the board has taken them."""
    if save:
        try:
            mount.save()
        except KeyboardInterrupt:
            raise KeyboardInterrupt("stopped; the board uses the settings, and may not have saved them") from None
    return saved if save else _LASTS


def _saved(mount: Mount, address: str | None) -> str:
    """What a save is called: on a virtual board that this command has started it may not last."""
    if address is None or not hasattr(mount.link.port, "simulation") or _KEEPS.search(find_port(address).address):
        return _SAVED
    return _SAVED + _GONE


def _setting(name: str) -> Setting:
    """The setting called "x.pulse_us". Raises BadValue with the names of all, and which of them are an encoder's."""
    try:
        return setting(name)
    except BadValue as e:
        raise BadValue(f"{e} (from {next(iter(ENCODER))} on: of an axis with an encoder)") from None


COMMANDS = (Command("config", "show, change, save, export and import settings", run, arguments),)
