"""docs/security.md names a test in each row of its tables, and that test exists."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
PAGE = (ROOT / "docs" / "security.md").read_text()
ROWS = [row.strip("|").split("|") for row in PAGE.splitlines() if row.startswith("| ") and not row.startswith("| what")]


def test_every_entrance_has_a_table_and_every_row_a_test():
    assert len(ROWS) == len(re.findall(r"^\|", PAGE, re.MULTILINE)) - 2 * PAGE.count("| what | held by |")
    assert PAGE.count("| what | held by |") == len(re.findall(r"^## ", PAGE, re.MULTILINE))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[-1].strip())
def test_the_test_that_holds_a_row_exists(row):
    path, _, name = row[-1].strip().partition("::")
    names = {n.name for n in ast.walk(ast.parse((ROOT / path).read_text())) if isinstance(n, ast.FunctionDef)}
    assert name in names if name else any(n.startswith("test_") for n in names)
