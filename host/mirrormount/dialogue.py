"""Questions to a person at a terminal. What cannot be understood is asked again. Imports errors."""

from collections.abc import Callable
from typing import TypeVar

from mirrormount.errors import BadValue

T = TypeVar("T")


class Dialogue:
    """Asks with ask(question), which returns a line or raises EOFError, and tells with say(text)."""

    def __init__(self, ask: Callable[[str], str] = input, say: Callable[[str], None] = print) -> None:
        self._ask = ask
        self.say = say

    def until(self, question: str, parse: Callable[[str], T]) -> T:
        """Ask until parse(answer) does not raise BadValue. Returns what it returns."""
        while True:
            try:
                return parse(self._ask(question + " ").strip().lower())
            except BadValue as e:
                self.say(f"  {e}")

    def choice(self, question: str, words: tuple[str, ...]) -> str:
        """One of these words; its first letters are enough where no other word begins so."""

        def parse(answer: str) -> str:
            found = [word for word in words if answer and word.startswith(answer)]
            if len(found) != 1:
                raise BadValue(f"please answer {', '.join(words[:-1])} or {words[-1]}")
            return found[0]

        return self.until(f"{question} [{'/'.join(words)}]", parse)

    def yes(self, question: str) -> bool:
        """True for yes, False for no; there is no default."""
        return self.choice(question, ("yes", "no")) == "yes"

    def number(self, question: str, least: float, most: float, default: float | None = None) -> float:
        """A number within least … most; with a default, an empty answer means that."""

        def parse(answer: str) -> float:
            if not answer and default is not None:
                return default
            try:
                value = float(answer.replace(",", ".")) if answer.isascii() else float("nan")
            except ValueError:
                value = float("nan")
            if not least <= value <= most:
                raise BadValue(f"please give a number within {least:g} … {most:g}")
            return value

        return self.until(question if default is None else f"{question} [{default:g}]", parse)

    def enter(self, question: str, way_out: str) -> bool:
        """True for Enter alone, False for the word way_out."""

        def parse(answer: str) -> bool:
            if answer not in ("", way_out):
                raise BadValue(f"please press Enter, or type {way_out}")
            return not answer

        return self.until(f"{question} [Enter, or {way_out}]", parse)
