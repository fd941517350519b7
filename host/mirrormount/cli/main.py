"""The shell command `mirrormount`: the table of commands, the parser made of it, and the exit status.

An error is one line on stderr, with two more for cause and remedy if the board has numbered it, and exit status 1;
wrong usage is 2, and so is no command at all, which prints the list of them; Ctrl-C stops the motors and is 130;
SIGTERM or SIGHUP, where a command ends in order on it, 128 + its number. Only the module of the command that is typed
is imported, so that a stop does not wait for the others.
"""

import argparse
import contextlib
import importlib
import io
import os
import re
import sys
from collections.abc import Sequence
from typing import Any

from mirrormount.cli.arguments import Command, from_extra, no_arguments, no_work, table_option, whence
from mirrormount.errors import BadValue, ExtraMissing, MountError, explain
from mirrormount.terminal import Terminated, printable
from mirrormount.values import TABLE_VARIABLE, did_you_mean
from mountfw import __version__

# ---- the parser

_NEGATIVE = re.compile(r"-\.?[0-9]")


class Parser(argparse.ArgumentParser):
    """A parser that takes no part of an option for the option: what turns a motor is written in full.

    Its subparsers are of this class, too, so an argument that a command does not know is told with that command's
    usage, not with that of the whole.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False)
        self._negative_number_matcher = _NEGATIVE  # argparse takes -1e-3 and -5urad for options

    def parse_known_args(self, *given: Any, **named: Any) -> Any:
        """As argparse's, but nothing is left that nobody knows."""
        found, unknown = super().parse_known_args(*given, **named)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}{self._in_full(unknown)}")
        return found, unknown

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """As argparse's; of a word that is nearly one of the choices, that one is told instead of all."""
        if action.choices is not None and value not in action.choices:
            meant = did_you_mean(str(value), map(str, action.choices))
            if meant:
                raise argparse.ArgumentError(action, f"there is no {value!r}{meant}")
        super()._check_value(action, value)

    def _in_full(self, unknown: Sequence[str]) -> str:
        """The options of which an unknown word is the beginning, or nearly one, to follow an error; "" without any."""
        words = [word.partition("=")[0] for word in unknown if word.startswith("--")]
        meant = [name for name in self._option_string_actions if any(name.startswith(word) for word in words)]
        if meant:
            return f" (an option is written in full: {' or '.join(meant)})"
        return "".join(did_you_mean(word, self._option_string_actions) for word in words[:1])


class WholeParser(Parser):
    """The parser of the whole command line."""

    def parse_known_args(self, *given: Any, **named: Any) -> Any:
        """As Parser's. An option that stands before its command is told as such."""
        words = sys.argv[1:] if not given or given[0] is None else given[0]
        option = words[0].partition("=")[0] if words else ""
        if option.startswith("--") and option not in self._option_string_actions:
            self.error(f"{option} stands behind the command: mirrormount COMMAND {option}")
        return super().parse_known_args(*given, **named)

    def add_subparsers(self, **options: Any) -> Any:
        """As argparse's: for commands, which are plain parsers."""
        return super().add_subparsers(parser_class=Parser, **options)


# ---- the table of commands

# The modules of the thin host's commands, by the commands' names, in the order of the help. The commands of the other
# packages are entry points of the group GROUP (pyproject.toml), with the extras that they need. Each module lists its
# commands in COMMANDS.
MODULES = {
    **dict.fromkeys(("ports", "status"), "mirrormount.cli.status"),
    **dict.fromkeys(("step", "move", "home", "zero", "jog", "drive"), "mirrormount.cli.motion"),
    "stop": "mirrormount.cli.stop",
    **dict.fromkeys(("keep", "back", "undo", "log"), "mirrormount.cli.presets"),
    "config": "mirrormount.cli.config",
    "check": "mirrormount.cli.check",
    "setup": "mirrormount.cli.setup",
    "table": "mirrormount.cli.table",
    "serve": "mirrormount.cli.serve",
    "flash": "mirrormount.cli.flash",
    **dict.fromkeys(("deploy", "undeploy", "repl", "send"), "mirrormount.cli.board"),
}
GROUP = "mirrormount.commands"

# ---- the exit status

_LONGEST_MESSAGE = 2000  # characters


def main(argv: list[str] | None = None) -> int:
    """Run the command line. Returns the exit status."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal without … or ± shows their numbers
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(errors="replace")  # a byte that is no text is a wrong answer: it is asked again
    args = argparse.Namespace()
    try:
        words = sys.argv[1:] if argv is None else argv
        whole = parser(_named(words))
        args = whole.parse_args(words)
        if args.command is None:
            whole.print_help(sys.stderr)
            return 2
        if "table" in args:
            if not args.table:
                raise BadValue("--table needs a file's name")
            os.environ[TABLE_VARIABLE] = args.table  # for this process, and for those that it starts
        status = args.run(args) or 0
        if sys.stdout:
            sys.stdout.flush()  # what cannot be written is told now, not when Python ends
        return status
    except MountError as e:
        _complain(f"{e}{whence(args, str(e))}", *_explained(e))
        return 1
    except KeyboardInterrupt as e:
        _complain(str(e) or "stopped")
        return 130
    except Terminated as e:
        _complain(str(e))
        return 128 + e.number
    except BrokenPipeError:
        _abandon_stdout()
        return 1
    except OSError as e:
        _abandon_stdout()
        _complain(f"{e.filename or 'standard output'}: {e.strerror or e}")
        return 1
    except Exception as e:
        if os.environ.get("MIRRORMOUNT_TRACEBACK"):
            raise
        _complain(
            f"a fault of this program, please report it ({type(e).__name__}: {e});"
            " with MIRRORMOUNT_TRACEBACK=1 it says where"
        )
        return 1


def _explained(e: MountError) -> list[str]:
    if not e.codes:
        return []
    return explain(e.codes)


def _complain(message: str, *more: str) -> None:
    """Print an error on stderr: one line, in which nothing from outside controls the terminal."""
    if sys.stderr:
        with contextlib.suppress(OSError):
            print("\n".join([f"mirrormount: {printable(message, _LONGEST_MESSAGE)}", *more]), file=sys.stderr)


def _abandon_stdout() -> None:
    """Nobody takes what is printed: without this, Python complains at its end."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def commands(names: Sequence[str]) -> list[Command]:
    """The rows of the table of these commands, from their modules.

    Raises ExtraMissing if the only one needs packages that are not installed; of several, its summary says so.
    """
    others = {} if all(name in MODULES for name in names) else _of_other_packages()
    found: dict[str, Command] = {}
    for name in names:
        if name in found:
            continue
        module, extras = (MODULES[name], "") if name in MODULES else others[name]
        try:
            with from_extra(extras, f"`mirrormount {name}` needs"):
                rows: list[Command] = importlib.import_module(module).COMMANDS
            found.update({row.name: _with_extras(row, extras) for row in rows})
        except ExtraMissing:
            if len(names) == 1:
                raise
            found[name] = Command(name, f"(needs the extra {extras}, which is not installed)", no_work, no_arguments)
    return [found[name] for name in names]


def _with_extras(command: Command, extras: str) -> Command:
    """The command, which tells the extras that it needs if one of its own imports finds them missing."""

    def run(args: argparse.Namespace) -> int | None:
        with from_extra(extras, f"`mirrormount {command.name}` needs"):
            return command.run(args)

    return command._replace(run=run) if extras else command


def _of_other_packages() -> dict[str, tuple[str, str]]:
    """The module of each command of the other packages, and the extras that it needs."""
    from importlib.metadata import entry_points

    return {point.name: (point.module, ",".join(point.extras)) for point in entry_points(group=GROUP)}


def _named(words: Sequence[str]) -> Sequence[str]:
    """The names of the commands that the parser of a command line needs: one, or all if the words name none."""
    if words[:1] == ["--version"]:
        return []
    at = 2 if words[:1] == ["--table"] else 1 if words and words[0].startswith("--table=") else 0
    word = words[at : at + 1]
    if word and word[0] in MODULES:
        return word
    every = [*MODULES, *_of_other_packages()]
    return word if word and word[0] in every else every


def parser(names: Sequence[str] | None = None) -> WholeParser:
    """The parser of a command line with these commands (None: all), from the table."""
    whole = WholeParser(
        prog="mirrormount",
        description="Drive a motorised mirror mount.",
        epilog="AXIS is x (right +) or y (up +).",
    )
    whole.add_argument("--version", action="version", version=f"mirrormount {__version__}")
    table_option(whole)
    subparsers = whole.add_subparsers(dest="command", metavar="COMMAND")
    for command in commands(_named([]) if names is None else names):
        sub = subparsers.add_parser(command.name, help=command.summary, description=command.summary)
        command.arguments(sub)
        sub.set_defaults(run=command.run)
    return whole
