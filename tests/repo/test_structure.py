"""Facts about how the code is put together that import-linter's contracts in pyproject.toml do not hold."""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
HOST = ROOT / "host"
FIRMWARE = ROOT / "firmware_py" / "mountfw"
TOOLS = ROOT / "tools"

# imports by a name in a string, of the packages above: a scheme of addresses, a command, the list of cameras
DYNAMIC = {
    "mirrormount/transport/ports.py": 1,
    "mirrormount/cli/main.py": 1,
    "mirrormount/cli/table.py": 1,
    "mirrormount_beam/signals.py": 1,  # a function of the person's own, whom --signal python: names
}


def modules(*roots: Path) -> list[Path]:
    """Every Python file below these folders; the stubs of tools are no code."""
    found = [path for root in roots for path in sorted(root.rglob("*.py")) if "typings" not in path.parts]
    assert len(found) > 20 * len(roots)
    return found


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__")


def private_uses(path: Path, text: str) -> Iterator[str]:
    """Private names of other modules of ours that a file imports, or takes from a module that it has imported.

    A module called _name is its folder's: files beside it may import it.
    """
    tree = ast.parse(text)
    ours: set[str] = set()
    beside = {p.stem for p in path.parent.glob("*.py")}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                first = alias.name.split(".")[0]
                if first in ("mirrormount", "mountfw") or first in beside:
                    ours.add(alias.asname or first)
                    if any(is_private(part) for part in alias.name.split(".")) and alias.name not in beside:
                        yield alias.name
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            if node.level or module.split(".")[0] in {"mirrormount", "mountfw"} | beside:
                for alias in node.names:
                    ours.add(alias.asname or alias.name)
                    if is_private(alias.name) or (any(map(is_private, module.split("."))) and module not in beside):
                        yield f"{module}.{alias.name}"
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and is_private(node.attr) and ast.unparse(node.value).split(".")[0] in ours:
            yield ast.unparse(node)


def test_no_file_takes_a_private_name_of_another_module():
    taken = {str(p.relative_to(ROOT)): [*private_uses(p, p.read_text())] for p in modules(HOST, FIRMWARE, TOOLS)}
    assert {path: names for path, names in taken.items() if names} == {}


@pytest.mark.parametrize(
    "text",
    [
        "from mirrormount.errors import _secret",
        "from mirrormount._common import errors",
        "import mountfw._wire",
        "from mountfw import app\nprint(app._SPIN_US)",
        "import mountfw.app\nprint(mountfw.app._SPIN_US)",
        "def f():\n    from mountfw.app import App\n    App._step(0)",
    ],
)
def test_a_private_name_of_another_module_is_seen(text):
    assert [*private_uses(HOST / "made_up.py", text)]


def test_dunders_and_names_of_other_peoples_modules_are_not_meant():
    text = "import os\nfrom mirrormount import __version__\nos._exit(0)\nself._x = __version__"
    assert [*private_uses(HOST / "made_up.py", text)] == []


def test_no_class_of_the_loop_has_a_property():
    # MicroPython then searches the class and its bases at each `self.name =` (docs/architecture.md)
    found = [path.name for path in modules(FIRMWARE) if re.search(r"@property|\bproperty\(", path.read_text())]
    assert found == ["repl.py"], "at the prompt it costs nothing"


def dynamic_imports(tree: ast.AST) -> int:
    """How many imports a file does by a name that is no constant."""
    found = 0
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func).split(".")[-1]
            found += name in ("import_module", "__import__", "run_module", "run_path", "spec_from_file_location")
    return found


def test_the_host_imports_by_a_name_in_a_string_only_schemes_and_commands():
    counts = {}
    for path in modules(HOST):
        # what an inner interpreter runs is a program of its own: it fences imports off for the firmware that it hosts
        if path.parent.name == "boot" or path.parent.name.startswith("fakes"):
            continue
        number = dynamic_imports(ast.parse(path.read_text()))
        if number:
            counts[path.relative_to(HOST).as_posix()] = number
    assert counts == DYNAMIC


def test_every_folder_of_modules_is_a_package_that_the_contracts_see():
    # import-linter passes over a folder without __init__.py; entry and boot files and fakes are programs
    folders = {path.parent for root in (HOST, FIRMWARE) for path in modules(root)}
    programs = {folder for folder in folders if folder.name in ("entry", "boot", "fakes", "fakes_circuitpython")}
    without = {folder for folder in folders if not (folder / "__init__.py").is_file()}
    assert without == programs, "an __init__.py is missing, or is where programs are"


def contracts() -> dict[str, dict]:
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    return {contract["id"]: contract for contract in tools["contracts"]}


def test_the_contracts_forbid_the_host_all_of_the_firmware_but_what_is_named():
    shared = {"wire", "codes", "settings", "board_file", "boards", "dialect.line"}
    forbidden = {name.removeprefix("mountfw.") for name in contracts()["host-takes-the-wire"]["forbidden_modules"]}
    files = [p for p in modules(FIRMWARE) if p.name != "__init__.py" and p.parent.name != "entry"]
    names = [".".join(path.relative_to(FIRMWARE).with_suffix("").parts) for path in files]
    wrong = [n for n in names if n not in shared and not {n, n.split(".")[0]} & (shared | forbidden)]
    assert not wrong, f"name each in forbidden_modules of pyproject.toml, or in `shared` here: {', '.join(wrong)}"


def test_no_part_of_the_core_may_name_a_port():
    parts = {p.stem for p in FIRMWARE.glob("*.py")} | {p.parent.name for p in FIRMWARE.glob("*/__init__.py")}
    held = {name.removeprefix("mountfw.") for name in contracts()["firmware-core-names-no-port"]["source_modules"]}
    assert held == parts - {"__init__", "ports", "codes", "settings", "start", "board_file", "boards"}
