"""Small TOML files: read with a clear error, written by whole_file.py. Imports errors, whole_file."""

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mirrormount.common.errors import BadFile
from mirrormount.common.printable import printable
from mirrormount.common.whole_file import write as write

_LONGEST = 1 << 18  # bytes of a file
_LONGEST_LINE = 1000  # characters; the parser's time grows with the square of the dots in a key
MOST = _LONGEST + 1  # what is to be read of a file: with the byte too many
_DEEPEST = 20  # tables in one another; a file of scales has two
_LARGEST = 1 << 63  # TOML's own limit of a whole number, which the parser does not check
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def parse(text: str, name: str) -> dict[str, Any]:
    """The tables of a TOML text; name is what an error calls it. Raises BadFile, which tells the line."""
    if len(text) > _LONGEST:
        raise BadFile(f"{name}: more than {_LONGEST} bytes, so no file of settings or of scales")
    if max(map(len, text.split("\n"))) > _LONGEST_LINE:
        raise BadFile(f"{name}: a line of more than {_LONGEST_LINE} characters, so no file of settings or of scales")
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as e:
        raise BadFile(f"{name}: not TOML: {printable(str(e))}") from e
    except ValueError as e:  # a number of thousands of digits
        raise BadFile(f"{name}: a number in it is too long") from e
    except RecursionError as e:
        raise BadFile(f"{name}: brackets in it are nested too deeply") from e
    _check(tables, name)
    return tables


def _check(tables: dict[str, Any], name: str) -> None:
    """Raise BadFile for tables that are nested too deeply, or a number that no setting and no scale can have."""
    left: list[tuple[Any, int]] = [(tables, 0)]
    while left:
        value, depth = left.pop()
        if depth > _DEEPEST:
            raise BadFile(f"{name}: tables in it are nested too deeply")
        if isinstance(value, int) and not -_LARGEST <= value < _LARGEST:
            raise BadFile(f"{name}: a number in it is too long")
        inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        left += [(one, depth + 1) for one in inner]


def read(path: Path) -> dict[str, Any]:
    """The tables of a file; none if it does not exist. Raises BadFile."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST)
        if len(content) > _LONGEST:  # before its last character, perhaps cut, is looked at
            raise BadFile(f"{path}: more than {_LONGEST} bytes, so no file of settings or of scales")
        return parse(content.decode("utf-8"), str(path))
    except FileNotFoundError:
        return {}
    except UnicodeDecodeError as e:
        raise BadFile(f"{path}: not a text file (byte {e.start})") from e
    except OSError as e:
        raise BadFile(f"{path}: {e.strerror}") from e


def text_for(path: Path, tables: Mapping[str, Any], heading: str) -> str:
    """text() of tables most of which were read from that file, which anybody may have written. Raises BadFile."""
    try:
        return text(tables, heading)
    except BadFile as e:
        raise BadFile(f"{path}: {e}: correct it, or move the file away") from e


def text(tables: Mapping[str, Any], heading: str) -> str:
    """Tables of numbers, truth values and texts as TOML, below a heading of comments. Raises BadFile."""
    lines = [f"# {line}" for line in heading.splitlines()]
    _add(lines, tables, ())
    return "\n".join(lines) + "\n"


def _add(lines: list[str], table: Mapping[str, Any], path: tuple[str, ...]) -> None:
    values = {key: value for key, value in table.items() if not isinstance(value, Mapping)}
    if path and (values or not table):
        lines += ["", f"[{'.'.join(map(_key, path))}]"]
    lines += [f"{_key(key)} = {_value(value, key)}" for key, value in values.items()]
    for key, value in table.items():
        if isinstance(value, Mapping):
            _add(lines, value, (*path, key))


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _value(key, key)


def _value(value: object, key: str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # a TOML string escapes as JSON does
    shown = printable(str(value), 60)
    raise BadFile(f"{printable(key, 60)} = {shown} is no number, truth value or text, as all in these files is")
