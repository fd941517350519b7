"""The shell command `mirrormount`: the table of commands, the parser made of it, and the exit status.

An error is one line on stderr, with two more for cause and remedy if the board has numbered it, and exit status 1;
wrong usage is 2, and so is no command at all, which prints the list of them; Ctrl-C stops the motors and is 130;
SIGTERM or SIGHUP, where a command ends in order on it, 128 + its number. Only the module of the command that is typed
is imported, and it imports the modules of its work when it runs: a stop must not wait for the others.
"""

import argparse
import contextlib
import importlib
import io
import os
import sys
from collections.abc import Sequence

from mirrormount.cli.command import Command, table_option, whence
from mirrormount.cli.parser import WholeParser
from mirrormount.common.errors import BadValue, MountError
from mirrormount.common.names import TABLE_VARIABLE
from mirrormount.common.printable import printable
from mirrormount.common.signals import Terminated
from mountfw import __version__

# The modules of the commands, by the commands' names, in the order of the help. A module has its Commands in COMMANDS.
MODULES = {
    "ports": "mirrormount.cli.ports",
    "status": "mirrormount.cli.status",
    **dict.fromkeys(("step", "move", "home", "jog", "drive"), "mirrormount.cli.motion"),
    "stop": "mirrormount.cli.stop",
    "send": "mirrormount.cli.send",
    "config": "mirrormount.cli.config",
    "check": "mirrormount.cli.check",
    "setup": "mirrormount.cli.setup",
    "table": "mirrormount.cli.table",
    "virtual": "mirrormount.virtual.cli",
    "serve": "mirrormount.cli.serve",
    "panel": "mirrormount.cli.panel",
    "deploy": "mirrormount.cli.deploy",
    "undeploy": "mirrormount.cli.undeploy",
    "repl": "mirrormount.cli.repl",
    "camera": "mirrormount.cli.camera",
    "scan": "mirrormount.cli.scan",
    "measure": "mirrormount.cli.measure",
    **dict.fromkeys(("calibrate", "align", "hold"), "mirrormount.cli.hold"),
    "report": "mirrormount.cli.report",
    "demo": "mirrormount.virtual.cli",
}

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
    from mirrormount.common.remedies import explain

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
    """The rows of the table of these commands, from their modules."""
    modules = [importlib.import_module(name) for name in dict.fromkeys(MODULES[name] for name in names)]
    return [command for module in modules for command in module.COMMANDS if command.name in names]


def _named(words: Sequence[str]) -> Sequence[str]:
    """The names of the commands that the parser of a command line needs: one, or all if the words name none."""
    if words[:1] == ["--version"]:
        return []
    at = 2 if words[:1] == ["--table"] else 1 if words and words[0].startswith("--table=") else 0
    return [word for word in words[at : at + 1] if word in MODULES] or [*MODULES]


def parser(names: Sequence[str] = tuple(MODULES)) -> WholeParser:
    """The parser of a command line with these commands, from the table."""
    whole = WholeParser(
        prog="mirrormount",
        description="Drive a motorised mirror mount.",
        epilog="AXIS is x (right +) or y (up +).",
    )
    whole.add_argument("--version", action="version", version=f"mirrormount {__version__}")
    table_option(whole)
    subparsers = whole.add_subparsers(dest="command", metavar="COMMAND")
    for command in commands(names):
        sub = subparsers.add_parser(command.name, help=command.summary, description=command.summary)
        command.arguments(sub)
        sub.set_defaults(run=command.run)
    return whole
