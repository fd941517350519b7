"""Constants of the firmware, written into the places that use them: less memory, and no look-up while a motor runs.

MicroPython's compiler does so within a file, and only for names that begin with an underscore. Here all files are
compiled at once, so it can be done for the names that files share.
"""

import ast
import operator
from collections.abc import Mapping

_CALLS = ("const", "_error", "_axis_error", "_reason")  # what declares a number, its first argument
_OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.LShift: operator.lshift,
    ast.BitOr: operator.or_,
}

Constants = dict[str, int]
_Place = tuple[int, int]
_Placed = ast.expr | ast.stmt


def inlined(sources: Mapping[str, bytes], package: str) -> dict[str, bytes]:
    """{path: source} of all files, without the constants of a package: each use is the value.

    Lines keep their numbers. Raises ValueError, with the file and the line, for what is not Python, and where a name
    would no longer mean the same: a constant that is assigned again, or a module of constants that is used as a value.
    """
    trees = _trees(sources, package)
    known = _known(trees)
    found = dict(sources)
    for path, tree in trees.items():
        found[path] = _edited(sources[path], _Edits(path, tree, known).edits)
    return found


def constants(sources: Mapping[str, bytes], package: str) -> dict[str, Constants]:
    """{module: {name: value}}: names in capitals that a file assigns at its top level, but for board files.

    `NAME = 5`, `NAME = const(1 << OTHER)`, or as codes.py declares it. Raises ValueError for what is not Python.
    """
    return _known(_trees(sources, package))


def _trees(sources: Mapping[str, bytes], package: str) -> dict[str, ast.Module]:
    found: dict[str, ast.Module] = {}
    for path, text in sources.items():
        if path.startswith(f"{package}/"):
            try:
                found[path] = ast.parse(text, path)
            except SyntaxError as e:
                raise ValueError(f"{path}, line {e.lineno}: {e.msg}") from None
    return found


def _known(trees: Mapping[str, ast.Module]) -> dict[str, Constants]:
    found: dict[str, Constants] = {}
    before = -1
    while before != (before := sum(map(len, found.values()))):  # again: one may be made of another file's
        for path, tree in trees.items():
            if "/boards/" not in path:
                found[_module(path)] = _constants(tree, found)
    return found


def _module(path: str) -> str:
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def _constants(tree: ast.Module, known: Mapping[str, Constants]) -> Constants:
    found: Constants = {}
    taken: Constants = {}
    for node in tree.body:
        match node:
            case ast.ImportFrom(module=str(module), names=names):
                values = known.get(module, {})
                taken.update({a.asname or a.name: values[a.name] for a in names if a.name in values})
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
                for target, value in zip(targets, values, strict=True):
                    number = _value(value, taken | found)
                    if isinstance(target, ast.Name) and target.id.isupper() and number is not None:
                        found[target.id] = number
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if name.isupper():
                if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id in _CALLS:
                    value = value.args[0]
                number = _value(value, taken | found)
                if number is not None:
                    found[name] = number
            case _:
                pass
    return found


def _value(node: ast.expr, names: Constants) -> int | None:
    match node:
        case ast.Constant(value=int(value)) if not isinstance(value, bool):
            return value
        case ast.Name(id=name):
            return names.get(name)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            value = _value(operand, names)
            return None if value is None else -value
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            one, two = _value(left, names), _value(right, names)
            return None if one is None or two is None else _OPERATORS[type(op)](one, two)
        case _:
            return None


class _Edits(ast.NodeVisitor):
    """edits of one file: (line and column of the first character, those after the last one, new text)."""

    def __init__(self, path: str, tree: ast.Module, known: Mapping[str, Constants]) -> None:
        self.edits: list[tuple[_Place, _Place, str]] = []
        self._path = path
        self._known = known
        self._own = known.get(_module(path), {})
        self._names = dict(self._own)  # of this file: those that are a value here
        self._modules: dict[str, Constants] = {}  # names of this file that are modules
        self._top = tree.body
        self._declared: set[str] = set()
        self.visit(tree)

    def _replace(self, node: _Placed, text: str) -> None:
        self.edits.append((_start(node), _end(node), text))

    def _refuse(self, node: _Placed | ast.arg | ast.ExceptHandler, what: str) -> None:
        raise ValueError(f"{self._path}, line {node.lineno}: {what}, so a deploy cannot put constants in their places")

    def _bind(self, node: _Placed | ast.arg | ast.ExceptHandler, name: str | None) -> None:
        """node gives this name a meaning of its own."""
        if name in self._names:
            self._refuse(node, f"{name} is a constant, and is given another meaning")
        if self._modules.get(name or ""):
            self._refuse(node, f"{name} is a module of constants, and is given another meaning")

    def visit_arg(self, node: ast.arg) -> None:
        self._bind(node, node.arg)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self._bind(node, node.name)
        self.generic_visit(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._bind(node, node.name)
        self.generic_visit(node)

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> None:
        self._bind(node, node.name)
        self.generic_visit(node)

    def visit_Import(self, node: ast.Import) -> None:
        for alias in node.names:
            if self._known.get(alias.name):
                self._refuse(node, f"{alias.name} has constants: write `from ... import`")

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        module = self._known.get(node.module or "", {})
        kept: list[ast.alias] = []
        for alias in node.names:
            name = alias.asname or alias.name
            if name == "*" and module:
                self._refuse(node, f"{node.module} has constants: write their names")
            inner = f"{node.module}.{alias.name}"
            if inner in self._known:
                self._modules[name] = self._known[inner]
                kept.append(alias)
            elif alias.name in module:
                self._names[name] = module[alias.name]
            else:
                kept.append(alias)
        if len(kept) < len(node.names):
            text = f"from {node.module} import " + ", ".join(ast.unparse(a) for a in kept) if kept else "pass"
            self._replace(node, text)

    def visit_Assign(self, node: ast.Assign) -> None:
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=targets)]) if all(self._declares(node, t) for t in targets):
                self._replace(node, "pass")
            case ast.Assign(targets=[target], value=value) if self._declares(node, target):
                if isinstance(value, ast.Call) and ast.unparse(value.func) != "const":  # it does more
                    self.edits.append((_start(node), _start(value), ""))
                    self.visit(value)
                else:
                    self._replace(node, "pass")
            case _:
                self.generic_visit(node)

    def _declares(self, node: ast.Assign, target: ast.expr) -> bool:
        name = ast.unparse(target)
        declares = node in self._top and name in self._own and name not in self._declared
        if declares:
            self._declared.add(name)
        return declares

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if not isinstance(node.value, ast.Name) or node.value.id not in self._modules:
            self.generic_visit(node)
        elif node.attr in self._modules[node.value.id]:
            self._replace(node, _text(self._modules[node.value.id][node.attr]))

    def visit_Name(self, node: ast.Name) -> None:
        if not isinstance(node.ctx, ast.Load):
            self._bind(node, node.id)
        elif any(name[0] != "_" for name in self._modules.get(node.id, ())):
            self._refuse(node, f"{node.id} is a module of constants, and is used as a value")
        elif node.id in self._names:
            self._replace(node, _text(self._names[node.id]))


def _text(value: int) -> str:
    return f"({value})" if value < 0 else str(value)


def _start(node: _Placed) -> _Place:
    return node.lineno - 1, node.col_offset


def _end(node: _Placed) -> _Place:
    assert node.end_lineno is not None and node.end_col_offset is not None  # ast.parse() knows them
    return node.end_lineno - 1, node.end_col_offset


def _edited(text: bytes, edits: list[tuple[_Place, _Place, str]]) -> bytes:
    """text with these edits; lines that one joins are left empty behind it, so that no line's number changes."""
    lines = text.split(b"\n")
    for (first, column), (last, end), new in sorted(edits, reverse=True):
        joined = lines[first][:column] + new.encode() + lines[last][end:]
        lines[first : last + 1] = [joined] + [b""] * (last - first)
    return b"\n".join(lines)
