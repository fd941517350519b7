"""Cause and remedy of each error, read from its declaration: mountfw/codes.py, errors.py, beam_errors.py."""

import functools
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from mirrormount.common import beam_errors, errors
from mirrormount.common.declared import one_line, plain, texts
from mountfw import codes as wire


class Remedy(NamedTuple):
    """Why it happened, and the remedy."""

    cause: str
    remedy: str


def declared(text: str) -> Remedy | None:
    """Cause and remedy of a declaration's text, in the Markdown of docs/errors.md; None if it has no remedy."""
    cause, found, remedy = text.partition("Remedy: ")
    return Remedy(one_line(cause), one_line(remedy)) if found else None


@functools.cache
def of_the_board() -> dict[str, Remedy]:
    """{number: Remedy} of the board's numbered errors; "n04" is number 4 of an axis."""
    known: dict[str, Remedy] = {}
    for maker, form in (("_error", "{}"), ("_axis_error", "n{:02d}")):
        for name, text in texts("codes", maker).items():
            remedy = declared(text)
            if remedy:
                known[form.format(vars(wire)[name])] = remedy
    return known


@functools.cache
def of_the_host() -> dict[str, Remedy]:
    """{name: Remedy} of the host's errors, in the order of their declaration."""
    declarations = ((kind.__name__, declared(kind.__doc__ or "")) for kind in _kinds())
    return {name: remedy for name, remedy in declarations if remedy}


def _kinds() -> Iterator[type[errors.MountError]]:
    for module in (errors, beam_errors):
        for kind in vars(module).values():
            if isinstance(kind, type) and issubclass(kind, errors.MountError) and kind.__module__ == module.__name__:
                yield kind


def remedy_of(error: str) -> Remedy | None:
    """Cause and remedy of an error, without marks: by its number on the board ("104" is n04 on axis 1) or its name."""
    of_axis = "n" + error[1:] if len(error) == 3 and error.isdecimal() else ""
    known = of_the_board() | of_the_host()
    found = known.get(error) or known.get(of_axis)
    return Remedy(plain(found.cause), plain(found.remedy)) if found else None


def explain(codes: Iterable[int]) -> list[str]:
    """Lines with cause and remedy of errors of the board, each of them once."""
    known = [remedy for code in dict.fromkeys(codes) if (remedy := remedy_of(str(code)))]
    return [line for r in known for line in (f"  cause: {r.cause}", f"  remedy: {r.remedy}")]
