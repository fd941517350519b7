"""Command lines before they are sent: what they may be, which start a motion. The grammar: docs/protocol.md."""

import re

from mirrormount.common.errors import BadValue
from mirrormount.common.keep_alive import KEEP_ALIVE_MS

LONGEST = 128 - len(f"XK{KEEP_ALIVE_MS};;TB?")  # a line of the board has 128 characters

_COMMAND_LINE = re.compile(r" *([A-Za-z*1-9]|0[0-9]*>)")  # the table of first bytes in docs/protocol.md
_ADDRESS = re.compile(r" *[0-9]+ *>")
_STARTS_MOTION = re.compile(r"[ 0-9]*(PR|PA|XU|MV|MT|OR)(?!.*\?)", re.IGNORECASE)
_KEEP_ALIVE = re.compile(r"XK *([0-9]+)", re.IGNORECASE)


def check_line(line: str) -> None:
    """Raises BadValue for a text that is no command line, one with nothing behind a ; included."""
    if not isinstance(line, str):
        raise BadValue(f"a command line is text, not {line!r}")
    if not line.strip(" "):
        raise BadValue("the command line is empty")
    if not (line.isascii() and line.isprintable()):
        raise BadValue(f"a command line is printable ASCII, not {line!r}")
    if not _COMMAND_LINE.match(line):
        raise BadValue(f"{line!r} is no command line: a frame is sent by drive, a stop by stop")
    if not all(command.strip(" ") for command in line.split(";")):
        raise BadValue("a ; stands between two commands: leave out the one that has nothing behind it")


def check_query(query: str) -> None:
    """Raises BadValue for a text that is no query, or starts a motion."""
    if not (isinstance(query, str) and query.isascii() and query.isprintable()):
        raise BadValue(f"a query is printable ASCII, not {query!r}")
    if starts_motion(query):
        raise BadValue(f"{query!r} starts a motion: send() does that, and keeps it alive")


def starts_motion(line: str) -> bool:
    """True if a command of the line may start a motion."""
    return any(map(_STARTS_MOTION.match, line[_begin(line) :].split(";")))


def keep_alives_ms(line: str) -> list[int]:
    """The keep-alives that the line sets itself."""
    return [int(ms) for ms in _KEEP_ALIVE.findall(line)]


def with_keep_alive(line: str) -> str:
    """The line, with the host's keep-alive before its first command. Raises BadValue if it is too long for that."""
    if len(line) > LONGEST:
        raise BadValue(f"a command line that starts a motion has at most {LONGEST} characters, not {len(line)}")
    at = _begin(line)
    return f"{line[:at]}XK{KEEP_ALIVE_MS};{line[at:]}"


def _begin(line: str) -> int:
    """Where the first command begins: behind the address, if there is one."""
    address = _ADDRESS.match(line)
    return address.end() if address else 0
