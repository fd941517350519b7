"""Constants are written into the places that use them, before the firmware is compiled for a board."""

import ast
import importlib
import re

import pytest

from mirrormount.common.errors import DeployError
from mirrormount.deploy import firmware as fileset
from mirrormount.deploy.firmware import MPY_OF_PICO, firmware, sources
from mirrormount.deploy.inline import constants, inlined

SOURCES = sources("micropython")
CODES = b"""MESSAGES = {}


def _error(number, message):
    MESSAGES[number] = message
    return number


FULL = _error(6, b"FULL")
"""


def of(**files: str) -> dict[str, str]:
    """The files of a package after it, by name without .py; it has a codes.py."""
    given = {f"fw/{name}.py": text.encode() for name, text in files.items()} | {"fw/codes.py": CODES}
    return {path[3:-3]: text.decode() for path, text in inlined(given, "fw").items()}


@pytest.mark.parametrize(
    ("text", "after"),
    [
        ("FAR = 5\nx = FAR\n", "pass\nx = 5\n"),
        ("FAR = const(1 << 3 | 1)\nx = (FAR, -FAR)\n", "pass\nx = (9, -9)\n"),
        ("FAR = -1\nx = FAR ** 2\n", "pass\nx = (-1) ** 2\n"),
        ("A, B = 1, 2\nx = A + B\n", "pass\nx = 1 + 2\n"),
        ("A = 3\nB = A * 2 - 1\ndef f(): return B\n", "pass\npass\ndef f(): return 5\n"),
        ("from fw import codes\nx = codes.FULL\n", "from fw import codes\nx = 6\n"),
        ("from fw import codes as c\nx = c.FULL, c.MESSAGES\n", "from fw import codes as c\nx = 6, c.MESSAGES\n"),
        ("from fw.codes import FULL\nx = FULL\n", "pass\nx = 6\n"),
        ("from fw.codes import FULL as F, MESSAGES\nx = F\n", "from fw.codes import MESSAGES\nx = 6\n"),
        ("from fw.codes import (\n    FULL,\n)\nx = FULL\n", "pass\n\n\nx = 6\n"),
        ("x = 'é', self.FULL\n", "x = 'é', self.FULL\n"),
        (
            "NAMES = ('a',)\nON = True\nlow = 1\nx = NAMES, ON, low\n",
            "NAMES = ('a',)\nON = True\nlow = 1\nx = NAMES, ON, low\n",
        ),
        ("from fw import codes\nE = 'é', codes.FULL  # é\n", "from fw import codes\nE = 'é', 6  # é\n"),
    ],
)
def test_each_use_of_a_constant_is_its_value(text, after):
    assert of(a=text)["a"] == after


def test_a_declaration_that_does_more_is_kept():
    assert of(a="")["codes"].endswith('\n_error(6, b"FULL")\n')


def test_a_constant_may_be_made_of_another_files():
    files = of(a="from fw.b import FAR\nNEAR = FAR - 1\n", b="FAR = 5\n", c="from fw.a import NEAR\nx = NEAR\n")
    assert files["c"] == "pass\nx = 4\n"


def test_a_board_file_keeps_its_names_and_other_packages_are_left_alone():
    given = {"fw/boards/mine.py": b"LED = 25\n", "main.py": b"FAR = 5\n"}
    assert inlined(given, "fw") == given


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("FAR = 5\ndef f():\n    FAR = 6\n", "line 3: FAR is a constant, and is given another meaning"),
        ("FAR = 5\nFAR = 6\n", "line 2: FAR is a constant, and is given another meaning"),
        ("FAR = 5\ndef f(FAR): return FAR\n", "line 2: FAR is a constant, and is given another meaning"),
        ("FAR = 5\nf = lambda FAR: FAR\n", "line 2: FAR is a constant, and is given another meaning"),
        ("FAR = 5\nclass FAR: pass\n", "line 2: FAR is a constant, and is given another meaning"),
        ("FAR = 5\nfor FAR in (): pass\n", "line 2: FAR is a constant, and is given another meaning"),
        (
            "from fw import codes\ndef f(codes): pass\n",
            "line 2: codes is a module of constants, and is given another meaning",
        ),
        ("from fw import codes\nm = codes\n", "line 2: codes is a module of constants, and is used as a value"),
        ("import fw.codes as c\n", "line 1: fw.codes has constants: write `from ... import`"),
        ("from fw.codes import *\n", "line 1: fw.codes has constants: write their names"),
        ("x = 1\nif:\n", "line 2: invalid syntax"),
    ],
)
def test_what_cannot_be_done_is_said_with_its_line(text, says):
    with pytest.raises(ValueError, match=f"^fw/a.py, {re.escape(says)}"):
        of(a=text)


def test_a_firmware_that_is_not_python_is_no_traceback_at_a_deploy(monkeypatch):
    broken = SOURCES | {"mountfw/app.py": b"def run(:\n"}
    monkeypatch.setattr(fileset, "sources", lambda _platform: broken)
    with pytest.raises(DeployError, match=r"^the firmware cannot be compiled: mountfw/app.py, line 1: "):
        firmware(MPY_OF_PICO)


def test_the_firmwares_constants_have_the_values_that_they_have_here():
    found = constants(SOURCES, "mountfw")
    assert found["mountfw.codes"]["STOPPED"] == 2 and found["mountfw.motion.drive"]["NEVER_US"] == 1 << 29
    checked = 0
    for name, values in found.items():
        if not name.startswith(("mountfw.ports.", "mountfw.repl")):  # which need a board
            module = importlib.import_module(name)
            assert values == {constant: getattr(module, constant) for constant in values}
            checked += len(values)
    assert checked > 200


def test_no_file_keeps_a_constant_or_takes_one_from_another():
    known, after = constants(SOURCES, "mountfw"), inlined(SOURCES, "mountfw")
    assert not any(constants(after, "mountfw").values())
    for path, text in after.items():
        names: set[str] = set(known.get(path.removesuffix(".py").replace("/", "."), ()))
        modules: dict[str, set[str]] = {}
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom):
                for alias in node.names:
                    assert alias.name not in known.get(node.module or "", ()), f"{path} takes {alias.name}"
                    modules[alias.asname or alias.name] = set(known.get(f"{node.module}.{alias.name}", ()))
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                assert node.attr not in modules.get(node.value.id, ()), f"{path}: {ast.unparse(node)}"
            assert not (isinstance(node, ast.Name) and node.id in names), f"{path}: {ast.unparse(node)}"
