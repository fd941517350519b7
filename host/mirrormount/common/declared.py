"""The texts for people that follow the declarations in the firmware's source: words of settings, causes, remedies.

A compiler drops such a text, so a board does not hold it; it is read here, from the source, when it is first shown.
`python3 tools/tables.py` makes the tables of docs/ of the same texts.
"""

import functools
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import ast


@functools.cache
def texts(module: str, maker: str) -> dict[str, str]:
    """{name: text}, in their order, of the declarations in a module of mountfw that a call of maker makes.

    Such a declaration is `NAME = maker(...)`, or `maker(...)` with the name as its first argument that is a str.
    """
    import ast
    import importlib.resources
    import inspect
    import itertools

    source = importlib.resources.files("mountfw").joinpath(f"{module}.py").read_text("utf-8")
    found: dict[str, str] = {}
    for statement, after in itertools.pairwise(ast.parse(source).body):
        name = _declared(statement, maker)
        if name and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            found[name] = inspect.cleandoc(str(after.value.value))
    return found


def _declared(statement: "ast.stmt", maker: str) -> str:
    """The name that a statement declares with a call of maker; "" if it does not."""
    import ast

    match statement:
        case ast.Assign(targets=[ast.Name(id=name)], value=ast.Call(func=ast.Name(id=called))):
            return name if called == maker else ""
        case ast.Expr(value=ast.Call(func=ast.Name(id=called), args=arguments)) if called == maker:
            return next(a.value for a in arguments if isinstance(a, ast.Constant) and isinstance(a.value, str))
    return ""


def one_line(text: str) -> str:
    """A text without its line ends."""
    return " ".join(text.split())


def plain(markdown: str) -> str:
    """A text without the marks of its links and of code."""
    return re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", markdown).replace("`", "")
