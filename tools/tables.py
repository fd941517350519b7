"""Write the tables and lists that follow from declarations: .venv/bin/python tools/tables.py [--check]

Commands (docs/commands.md), errors and reasons (docs/errors.md), settings (docs/protocol.md, the attributes of an axis
on the board and its properties on the host), boards (docs/versions.md), the profiles of virtual mounts
(docs/mechanics.md), records (docs/control-systems.md), the measures of mirror mounts and the bill of materials
(docs/build.md), the grammar of a line (dialect/line.py of the firmware). The table
of docs/performance.md is copied into the host, as JSON.
--check changes nothing and fails if one of them differs.
"""

import importlib
import json
import re
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from importlib.metadata import entry_points
from pathlib import Path

import mirrormount_beam.errors  # noqa: F401  (with them, all errors are declared)
from mirrormount import errors
from mirrormount.cli import main as cli
from mirrormount.deploy.firmware import boards, firmware
from mirrormount.device.settings import ENCODER, SETTINGS
from mirrormount.errors import doc_texts, one_line
from mirrormount_epics import fields
from mirrormount_sim.profiles import PROFILES, facts
from mountfw import codes
from mountfw.board_file import FILE_OF
from mountfw.wire.frame import PROBE

sys.path.insert(0, str(Path(__file__).resolve().parent / "mechanics"))
import bill as mechanics_bill
from measures import MOUNTS, load

sys.path.insert(0, str(Path(__file__).resolve().parent / "bench"))
from rows import ON_THE_PAGE

ROOT = Path(__file__).resolve().parent.parent
FIRMWARE = ROOT / "firmware_py" / "mountfw"
Rows = Iterable[tuple[str, ...]]


def board_errors() -> Rows:
    """The board's numbered errors."""
    yield "number", "message", "cause", "remedy"
    messages = {str(n): text for n, text in codes.MESSAGES.items()}
    messages |= {f"n{n:02d}": text for n, text in codes.AXIS_MESSAGES.items()}
    for number, remedy in errors.board_remedies().items():
        yield number, messages[number].decode(), *remedy


def commands() -> Rows:
    """The shell commands."""
    yield "command", "what it does"
    names = [*cli.MODULES, *sorted(point.name for point in entry_points(group=cli.GROUP))]
    yield from ((f"`{command.name}`", one_line(command.summary)) for command in cli.commands(names))


def reasons() -> Rows:
    """Why a move ended."""
    yield "number", "words", "meaning"
    for name, text in doc_texts("codes", "_reason").items():
        number = vars(codes)[name]
        yield str(number), codes.REASONS[number], one_line(text)


def host_errors() -> Rows:
    """The errors of the host."""
    yield "error", "cause", "remedy"
    for name, remedy in errors.host_remedies().items():
        yield f"`{name}`", *remedy


def settings() -> Rows:
    """The settings of an axis. Those of an encoder come last; a board without one knows none."""
    yield "command", "name", "meaning", "range", "default", "in a move"
    for name, s in SETTINGS.items():
        bounds = ", ".join(map(str, s.among)) if s.among else f"{_number(s.least)} … {_number(s.most)}"
        meaning = f"{s.what}. {s.details}" if s.details else s.what
        yield f"`n{s.command}v`", f"`{name}`", meaning, bounds, _number(s.default), "n14" if s.at_rest else ""


def board_files() -> Rows:
    """The board files."""
    yield "board file", "`*IDN?` says", "names that platforms give the board", "tried"
    for name in boards(firmware(None)):
        module = importlib.import_module(f"mountfw.boards.{name}")
        tried = re.search(r"(?:Not tried|Tried) .*?\.(?=\s|$)", one_line(module.__doc__ or ""))
        if not tried:
            raise SystemExit(f"mountfw/boards/{name}.py does not say what it was tried on")
        names = [f"`{other}`" for other, file in FILE_OF.items() if file == name] or ["–"]
        yield f"`{name}`", module.NAME.decode(), ", ".join(names), tried[0].rstrip(".")


def motor_fields() -> Rows:
    """The fields of a motor record."""
    return _fields(fields.MOTOR)


def mount_fields() -> Rows:
    """The fields of a mount record."""
    return _fields(fields.MOUNT)


def camera_fields() -> Rows:
    """The fields of a camera's record."""
    return _fields(fields.CAMERA)


def loop_fields() -> Rows:
    """The fields of the loop's record."""
    return _fields(fields.LOOP)


def _fields(table: Iterable[fields.Field]) -> Rows:
    yield "field", "by a client", "meaning"
    may = {fields.READ: "read", fields.WRITE: "write", fields.ACT: "order"}
    yield from ((f"`.{field.name}`", may[field.access], field.what) for field in table if field.what)
    if always := [f"`.{field.name}`" for field in table if not field.what]:
        yield " ".join(always), "read", "always the same; clients of motor records read them"


def _number(n: float) -> str:
    """A number with its thousands apart, and the minus sign of a text."""
    text = f"{n:,}".replace(",", " ")
    return "\N{MINUS SIGN}" + text[1:] if text.startswith("-") else text


def profiles() -> Rows:
    """What the profiles of virtual mounts differ by."""
    yield "", *(f"`{name}`" for name in PROFILES), "source of `hardware`"
    for name, what, source in facts():
        values = [getattr(profile, name) for profile in PROFILES.values()]
        cells = [("no", "yes")[v] if isinstance(v, bool) else f"{v:.3g}" for v in values]
        yield f"`{name}`: {what}", *cells, source


def attributes() -> Iterator[str]:
    """The settings as annotations of a class, for the firmware."""
    for name in SETTINGS:
        if name not in ENCODER:
            yield f"    {name}: int\n"


def properties() -> Iterator[str]:
    """The settings as properties of an axis, for the host."""
    for name, s in SETTINGS.items():
        yield f'    {name} = Property[{"float" if s.decimals else "int"}]()\n    """{s.group}: {s.what}"""\n'


_KINDS = "0A* >;\n+?.,"  # the kinds of bytes of a line, of which the first is a digit from 1 to 9
_ZERO, _OTHER, _COLUMNS = 11, 12, 13
_NOT_ALLOWED = 255


def _kind(c: int) -> int:
    """The column of a byte of a line."""
    if 0x30 <= c <= 0x39:
        return 0 if c > 0x30 else _ZERO
    if 0x41 <= c & 0xDF <= 0x5A:
        return 1
    kind = {0x0D: "\n", 0x2D: "+"}.get(c, chr(c))
    return (
        _KINDS.find(kind if kind in _KINDS else ",") if kind in _KINDS or (0x22 <= c < 0x7F and c != PROBE) else _OTHER
    )


def _bytes(data: Iterable[int]) -> Iterator[str]:
    """Bytes as a literal on several lines."""
    text = [f"\\x{n:02x}" for n in data]
    for at in range(0, len(text), 28):
        yield f'    b"{"".join(text[at : at + 28])}"\n'


def classes() -> Iterator[str]:
    """The column of each byte, for the firmware's grammar."""
    yield from _bytes(map(_kind, range(0x80)))


def transitions() -> Iterator[str]:
    """The grammar of a line (the comment in dialect/line.py) as a table: for each state, the next one by column."""
    text = (FIRMWARE / "dialect" / "line.py").read_text(encoding="utf-8").split("#\n# first ")[1]
    rows = [["first", *text.split("\n")[0].split()]]
    for line in text.split("\n")[1:]:
        if not line.startswith("# "):
            break
        rows.append(line[2:].split())
    number = {row[0]: n for n, row in enumerate(rows)}
    for name, *pairs in rows:
        next_ = [_NOT_ALLOWED] * _COLUMNS
        for byte, state in zip(pairs[::2], pairs[1::2], strict=True):
            if byte in ("0", "00"):
                next_[_ZERO] = number[state]
            if byte != "00":
                next_[_KINDS.find({"space": " ", "$": "\n"}.get(byte, byte))] = number[state]
        yield from (line.replace("\n", f"  # {name}\n") for line in _bytes(next_))


def mounts() -> Rows:
    """The measures of the mirror mounts that are known."""
    known = [load(path) for path in MOUNTS.values()]
    names = [name for name in known[0].sources if name in tomllib.loads(MOUNTS["km100"].read_text(encoding="utf-8"))]
    yield "mm", *(m.name for m in known)
    for name in names:
        yield f"`{name}`", *(f"{getattr(m, name):g}: {m.sources[name]}" for m in known)


def bill() -> Rows:
    """What one motorised mount is made of."""
    yield from mechanics_bill.table()


Maker = Callable[[], Rows] | Callable[[], Iterator[str]]
WRITTEN: dict[str, tuple[Maker, ...]] = {
    "docs/build.md": (mounts, bill),
    "docs/commands.md": (commands,),
    "docs/control-systems.md": (motor_fields, mount_fields, camera_fields, loop_fields),
    "docs/errors.md": (board_errors, reasons, host_errors),
    "docs/mechanics.md": (profiles,),
    "docs/protocol.md": (settings,),
    "docs/versions.md": (board_files,),
    "firmware_py/mountfw/dialect/line.py": (classes, transitions),
    "firmware_py/mountfw/settings.py": (attributes,),
    "host/mirrormount/device/axis.py": (properties,),
}


def written(page: str, makers: Iterable[Maker], *, code: bool) -> str:
    """A page, or code, with its parts as they are declared. Raises SystemExit if it has no place for one."""
    for maker in makers:
        mark, end = f"{maker.__name__}: made by tools/tables.py", "    # end\n" if code else "<!-- end -->"
        begin = f"    # {mark}\n" if code else f"<!-- {mark} -->\n"
        before, found, rest = page.partition(begin)
        if not found or end not in rest:
            raise SystemExit(f"no place for {maker.__name__}: {begin.strip()} ... {end.strip()}")
        lines = maker() if code else _markdown(maker())
        page = before + begin + "".join(map(str, lines)) + end + rest.partition(end)[2]
    return page


def _markdown(rows: Iterable[Iterable[str]]) -> Iterator[str]:
    for n, row in enumerate(map(tuple, rows)):
        yield f"| {' | '.join(row)} |\n"
        if n == 0:
            yield f"|{'---|' * len(row)}\n"


COPIED = "docs/performance.md", "host/mirrormount/performance.json"


def performance() -> str:
    """The table of docs/performance.md as JSON, for `check --timing`. Raises SystemExit if it is another."""
    page = (ROOT / COPIED[0]).read_text(encoding="utf-8")
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines() if line.startswith("| ")]
    figures = [row[:8] for row in cells if len(row) == 9 and row[2].isdecimal()]
    if len(figures) != len(ON_THE_PAGE):
        raise SystemExit("docs/performance.md has other rows than ON_THE_PAGE of tools/bench/rows.py")
    names = ("what", "unit", "n", "median", "p99", "worst", "sd", "must")
    rows = [{"name": n} | dict(zip(names, row, strict=True)) for n, row in zip(ON_THE_PAGE, figures, strict=True)]
    return json.dumps(rows, indent=1, ensure_ascii=False) + "\n"


def main(arguments: list[str]) -> int:
    """Returns the exit status: 1 if --check found a difference."""
    different = []
    for name, makers in WRITTEN.items():
        page = (ROOT / name).read_text(encoding="utf-8")
        wanted = written(page, makers, code=name.endswith(".py"))
        if page != wanted:
            different.append(name)
            if "--check" not in arguments:
                (ROOT / name).write_text(wanted, encoding="utf-8")
    copy = ROOT / COPIED[1]
    if not copy.exists() or copy.read_text(encoding="utf-8") != performance():
        different.append(COPIED[1])
        if "--check" not in arguments:
            copy.write_text(performance(), encoding="utf-8")
    for name in different:
        print(f"{name} {f'differs: {sys.executable} {__file__}' if '--check' in arguments else 'is written anew'}")
    return 1 if different and "--check" in arguments else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
