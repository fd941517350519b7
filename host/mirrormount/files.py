"""Files that are written whole or not at all, small TOML and JSON files, a temporary folder.

A file that write_atomic() writes holds the old content or the new one, never a part of it. Whatever is read may have
been written by somebody else, so a file that is too long, nested too deeply or no text is a clear error.
"""

import contextlib
import json
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mirrormount.errors import BadFile, CannotWrite
from mirrormount.terminal import printable

_TRIAL = bytes(1 << 16)  # A full disk still takes an empty file, so the trial is as long as a small file.


def write_atomic(path: Path, content: str | bytes, *, make_folder: bool = False) -> None:
    """Put content into a file: it then holds the old or the new, never a part.

    Nothing is written through a link. A folder is made only if make_folder says so. Raises CannotWrite.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        new = _beside(path, data, make_folder)
        try:
            new.chmod(0o666 & ~_umask())
            new.replace(path)
        except BaseException:
            _remove(new)
            raise
    except OSError as e:
        raise CannotWrite(f"cannot write {path}: {e.strerror}") from e


def check_writable(path: Path, *, make_folder: bool = False) -> None:
    """Raise CannotWrite if write_atomic() would: call it before long work whose result must not be lost."""
    try:
        _remove(_beside(path, _TRIAL, make_folder))
    except OSError as e:
        raise CannotWrite(f"cannot write {path}: {e.strerror}") from e


def _beside(path: Path, data: bytes, make_folder: bool) -> Path:
    """A new file in the folder of path that holds data. Raises CannotWrite, OSError; then there is none."""
    if path.is_symlink():
        raise CannotWrite(f"cannot write {path}: it is a link; name the file itself")
    if not path.name or (path.exists() and not path.is_file()):
        raise CannotWrite(f"cannot write {path}: it is not a file")
    if make_folder:
        path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name[:80]}.", dir=path.parent)
    new = Path(name)  # mkstemp made it, so it is no link that somebody has put there
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except BaseException:  # Ctrl-C, too
        _remove(new)
        raise
    return new


def _remove(file: Path) -> None:
    with contextlib.suppress(OSError):
        file.unlink()


def behind_link(path: Path) -> Path:
    """The file that a user's own link leads to, for write_atomic(): the link stays."""
    return Path(os.path.realpath(path))


def check_replaceable(path: Path, begins: str) -> None:
    """Raise CannotWrite if what is at path would be lost: a file that does not begin like its own kind, or no file."""
    try:
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise CannotWrite(f"cannot write {path}: it is a link, or not a file")
        if not path.exists():
            return
        with path.open("rb") as file:
            begun = file.read(len(begins))
    except OSError as e:
        raise CannotWrite(f"cannot write {path}: {e.strerror}") from e
    if begun and begun != begins.encode():
        raise CannotWrite(f"cannot write {path}: a file of that name exists, and is no report; name another one")


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


# ---- TOML

_LONGEST = 1 << 18  # bytes of a TOML file
_LONGEST_LINE = 1000  # characters: the parser's time grows with the square of the number of dots in a key
MOST_TOML = _LONGEST + 1  # Read one byte more than a file may have, to see that it is too long.
_DEEPEST = 20  # levels of nested tables; a file of scales has two
_LARGEST = 1 << 63  # TOML's own limit of a whole number, which the parser does not check
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """The tables of a TOML text; name is what an error calls it. Raises BadFile, which tells the line."""
    if len(text) > _LONGEST:
        raise BadFile(f"{name}: more than {_LONGEST} bytes, so no file of settings or of scales")
    if max(map(len, text.split("\n"))) > _LONGEST_LINE:
        raise BadFile(f"{name}: a line of more than {_LONGEST_LINE} characters, so no file of settings or of scales")
    import tomllib  # a stop needs none of it

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


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a file; none if it does not exist. Raises BadFile."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST_TOML)
        if len(content) > _LONGEST:  # first: the last character may be cut, which is no error of its own
            raise BadFile(f"{path}: more than {_LONGEST} bytes, so no file of settings or of scales")
        return parse_toml(content.decode("utf-8"), str(path))
    except FileNotFoundError:
        return {}
    except UnicodeDecodeError as e:
        raise BadFile(f"{path}: not a text file (byte {e.start})") from e
    except OSError as e:
        raise BadFile(f"{path}: {e.strerror}") from e


def toml_text_for(path: Path, tables: Mapping[str, Any], heading: str) -> str:
    """toml_text() of tables most of which were read from that file, which anybody may have written. Raises BadFile."""
    try:
        return toml_text(tables, heading)
    except BadFile as e:
        raise BadFile(f"{path}: {e}: correct it, or move the file away") from e


def toml_text(tables: Mapping[str, Any], heading: str) -> str:
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


# ---- JSON

MOST_JSON = 1 << 20  # bytes of a JSON file


def read_json(path: Path) -> Any:
    """The content of a file. Raises OSError, and ValueError if it is no JSON or more than MOST_JSON bytes."""
    with path.open("rb") as file:
        content = file.read(MOST_JSON + 1)
    if len(content) > MOST_JSON:
        raise ValueError(f"more than {MOST_JSON} bytes")
    return parse_json(content)


def parse_json(text: str | bytes) -> Any:
    """json.loads(), but text that is nested too deeply is a ValueError as well."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


# ---- folders


def cache() -> Path:
    """The folder for what can be fetched or made again: $MIRRORMOUNT_CACHE, else the user's."""
    from platformdirs import user_cache_path

    folder = os.environ.get("MIRRORMOUNT_CACHE")
    return Path(folder) if folder else user_cache_path("mirrormount")


with contextlib.suppress(OSError):
    tempfile.gettempdir()  # The first call tries a folder with a file: do that before a signal may end the program.


@contextlib.contextmanager
def scratch_folder() -> Iterator[str]:
    """The path of a new folder of this user's. It is gone at the end, also if a signal ends the program meanwhile.

    tempfile's own leaves the folder behind if the signal comes while it is made or removed. Raises OSError.
    """
    folder = Path(tempfile.gettempdir(), f"mirrormount-{secrets.token_hex(8)}")
    try:
        folder.mkdir(mode=0o700)
        yield str(folder)
    finally:
        try:
            shutil.rmtree(folder, ignore_errors=True)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)  # no second signal comes
            raise
