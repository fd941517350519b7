"""Board files on the host: which one a board takes, and whether one of somebody's own can work. None is executed."""

import ast
import importlib.resources
import re
from collections.abc import Collection
from pathlib import Path

from mirrormount.common.errors import DeployError
from mirrormount.common.printable import printable
from mirrormount.deploy.fileset import THIS, boards
from mountfw import board_file as on_board

_REQUIRED = set(on_board.REQUIRED)
_OPTIONAL = set(on_board.OPTIONAL)
_BRIDGES = tuple(on_board.BRIDGES)
_PINS = on_board.DRIVES + on_board.STOPS
_ENCODERS = on_board.ENCODERS  # of an axis that has one: two GPIO numbers
_SWITCHES = ("ONE_CHANNEL", "GATE", "LANE")
_NAME = re.compile(rb"[ -+\--:<-~]{1,40}")  # printable, without the comma and the semicolon of an answer
_RANGES = {"PWM_HZ": (100, 100_000), "DEAD_TIME_US": (0, 1000)}
_HIGHEST_GPIO = 48
_LONGEST = 1 << 16  # bytes of a board file
_DEEPEST = 8  # imports of a board file by a board file


def check_board_file(name: str, files: Collection[str]) -> None:
    """Raise DeployError unless a board that its platform calls `name` finds its board file among these paths."""
    names = {path.removesuffix(".mpy").removesuffix(".py") for path in files}
    machine = name.split(" with ")[0]
    plain = "".join(c.lower() if c.isalnum() else "_" for c in machine)
    if machine and not names & {THIS.removesuffix(".py"), f"mountfw/boards/{on_board.FILE_OF.get(plain, plain)}"}:
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
    wrong = _faults(found) or printable(on_board.fault(found))  # the board itself refuses what has a fault
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
    pins = [("LED", found["LED"], True), ("EMERGENCY_STOP", found.get("EMERGENCY_STOP"), True)]
    two_pwm = found["BRIDGE"] == "two-pwm"
    for axis in on_board.AXES:
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
