"""Imports that import-linter cannot see: one, by which a port's address opens a virtual board."""

import ast
from pathlib import Path

import pytest

from mirrormount.transport import open as opening

HOST = Path(__file__).parent.parent.parent / "host" / "mirrormount"
# They run as programs of their own, in place of a board's boot code, and load the firmware and the fakes beside them.
BOARDS = {"virtual/boot_cpython.py", "virtual/boot_circuitpython.py", "virtual/boot_micropython.py"}
BOARDS |= {"virtual/fakes/_fence.py"}
DYNAMIC = {"import_module", "__import__", "spec_from_file_location", "module_from_spec", "exec_module", "run_module"}


def dynamic_imports(text: str) -> list[str]:
    """The names by which a file imports at run time, one for each use."""
    nodes = list(ast.walk(ast.parse(text)))
    names = [node.attr for node in nodes if isinstance(node, ast.Attribute)]
    names += [node.id for node in nodes if isinstance(node, ast.Name)]
    return [name for name in names if name in DYNAMIC]


def test_the_host_has_one_dynamic_import():
    files = {path.relative_to(HOST).as_posix(): path for path in HOST.rglob("*.py")}
    assert set(files) > BOARDS | {"transport/open.py"}
    found = {name: dynamic_imports(path.read_text(encoding="utf-8")) for name, path in files.items()}
    assert {name for name, uses in found.items() if uses} - {"transport/open.py"} == BOARDS
    assert found["transport/open.py"] == ["import_module"]


@pytest.mark.parametrize("text", ["import importlib\nimportlib.import_module('a')", "__import__('a')"])
def test_a_dynamic_import_is_seen(text):
    assert dynamic_imports(text)


def test_the_table_of_schemes_leads_to_the_virtual_board():
    assert set(opening.SCHEMES) == {"socket", "virtual"}
    port = opening.open_port("virtual://?speed=max")
    assert port.lockstep
    port.close()
