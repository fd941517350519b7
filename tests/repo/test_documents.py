"""The names of files and functions in the documents are those of the tree."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
DOCS = ROOT / "docs"
PACKAGES = tuple(sorted(path.parent.name for path in (ROOT / "host").glob("*/__init__.py")))
# a name is relative to one of these
ROOMS = (ROOT / "firmware_py" / "mountfw", *(ROOT / "host" / name for name in PACKAGES), ROOT / "host", ROOT)
HELD = ("architecture.md",)
ON_A_BOARD = {"main.py", "boot.py", "code.py"}  # at the root of its file system
NAME = re.compile(r"`([\w./]+\.(?:py|js|mjs|sh))(?::([\w.]+))?`")


def text_of(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def defined(path: Path, name: str) -> bool:
    """True if the file defines it: a function, a class, a method as Class.method, or a name of the module."""
    if path.suffix != ".py":
        return re.search(rf"\b(function|const|class) {name}\b", path.read_text(encoding="utf-8")) is not None
    body: list[ast.stmt] = tree(path).body
    for part in name.split("."):
        found = [node for node in body if part in names_of(node)]
        if not found:
            return False
        body = getattr(found[0], "body", [])
    return True


def names_of(node: ast.stmt) -> set[str]:
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return {node.name}
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    return {target.id for target in targets if isinstance(target, ast.Name)}


def faults(text: str) -> list[str]:
    """The names in a text that the tree does not have, or has more than once."""
    wrong = []
    for file, name in NAME.findall(text):
        paths = [room / file for room in ROOMS if (room / file).is_file()]
        if file in ON_A_BOARD and not name:
            continue
        if len(paths) != 1 or (name and not defined(paths[0], name)):
            wrong.append(f"{file}:{name}" if name else file)
    return wrong


@pytest.mark.parametrize("page", HELD)
def test_the_files_and_functions_that_a_page_names_are_there(page):
    text = text_of(page)
    assert len(NAME.findall(text)) > 8
    assert faults(text) == []


def test_a_name_that_is_gone_is_found_to_be_gone():
    assert faults("`app.py:App` `app.py:gone` `app.py:App.gone` `gone.py`") == [
        "app.py:gone",
        "app.py:App.gone",
        "gone.py",
    ]


@pytest.mark.parametrize(
    "page", ["README.md", "CONTRIBUTING.md", *(f"docs/{p.name}" for p in sorted(DOCS.glob("*.md")))]
)
def test_every_file_of_code_that_a_document_names_exists(page):
    every = {
        p.relative_to(ROOT).as_posix()
        for folder in ("firmware_py", "host", "tests", "tools")
        for p in (ROOT / folder).rglob("*.*")
    }
    named = set(re.findall(r"`([\w./]+\.(?:py|js|mjs|sh))\b", (ROOT / page).read_text(encoding="utf-8")))
    known = {name for name in named if any(f"/{path}".endswith(f"/{name}") for path in every)}
    assert (
        named - known - ON_A_BOARD - {"boards/this.py", "mountfw/boards/this.py", "ports/NAME.py", "boards/NAME.py"}
        == set()
    )
