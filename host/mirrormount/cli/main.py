"""The shell command `mirrormount`: the table of commands, the parser made of it, and the exit status.

An error is one line on stderr, with two more for cause and remedy if the board has numbered it, and exit status 1;
wrong usage is 2, and so is no command at all, which prints the list of them; Ctrl-C stops the motors and is 130;
SIGTERM or SIGHUP, where a command ends in order on it, 128 + its number. Each command is a file here that imports the
modules of its work when it runs.
"""

import argparse
import contextlib
import io
import os
import sys

from mirrormount.cli import (
    camera,
    check,
    config,
    deploy,
    hold,
    measure,
    motion,
    panel,
    ports,
    repl,
    report,
    scan,
    send,
    serve,
    setup,
    status,
    stop,
    table,
    undeploy,
)
from mirrormount.cli.command import Command, table_option, whence
from mirrormount.cli.parser import WholeParser
from mirrormount.common.errors import BadValue, MountError
from mirrormount.common.names import TABLE_VARIABLE
from mirrormount.common.printable import printable
from mirrormount.common.remedies import explain
from mirrormount.common.signals import INTERRUPTS, Terminated
from mirrormount.virtual import cli as virtual_cli
from mountfw import __version__

COMMANDS: tuple[Command, ...] = (
    ports.COMMAND,
    status.COMMAND,
    *motion.COMMANDS,
    stop.COMMAND,
    send.COMMAND,
    config.COMMAND,
    check.COMMAND,
    setup.COMMAND,
    table.COMMAND,
    *virtual_cli.COMMANDS,
    serve.COMMAND,
    panel.COMMAND,
    deploy.COMMAND,
    undeploy.COMMAND,
    repl.COMMAND,
    camera.COMMAND,
    scan.COMMAND,
    measure.COMMAND,
    *hold.COMMANDS,
    report.COMMAND,
)

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
        whole = parser()
        args = whole.parse_args(argv)
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
        _complain(f"{e}{whence(args, str(e))}", *explain(e.codes))
        return 1
    except KeyboardInterrupt as e:
        return _stopped(str(e))
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
        if INTERRUPTS.came:
            return _stopped()
        if os.environ.get("MIRRORMOUNT_TRACEBACK"):
            raise
        _complain(
            f"a fault of this program, please report it ({type(e).__name__}: {e});"
            " with MIRRORMOUNT_TRACEBACK=1 it says where"
        )
        return 1


def _stopped(where: str = "") -> int:
    """Tell of Ctrl-C: further ones do nothing. Returns the exit status."""
    INTERRUPTS.over = True
    _complain(where or "stopped")
    return 130


def _complain(message: str, *more: str) -> None:
    """Print an error on stderr: one line, in which nothing from outside controls the terminal."""
    if sys.stderr:
        with contextlib.suppress(OSError):
            print("\n".join([f"mirrormount: {printable(message, _LONGEST_MESSAGE)}", *more]), file=sys.stderr)


def _abandon_stdout() -> None:
    """Nobody takes what is printed: without this, Python complains at its end."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def parser() -> WholeParser:
    """The parser of the whole command line, from the table."""
    whole = WholeParser(
        prog="mirrormount",
        description="Drive a motorised mirror mount.",
        epilog="AXIS is x (right +) or y (up +).",
    )
    whole.add_argument("--version", action="version", version=f"mirrormount {__version__}")
    table_option(whole)
    commands = whole.add_subparsers(dest="command", metavar="COMMAND")
    for command in COMMANDS:
        sub = commands.add_parser(command.name, help=command.summary, description=command.summary)
        command.arguments(sub)
        sub.set_defaults(run=command.run)
    return whole
