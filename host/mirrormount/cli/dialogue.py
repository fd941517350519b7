"""Questions to a person at a terminal. What cannot be understood is asked again. Imports errors."""

import re
from collections.abc import Callable
from typing import TypeVar

from mirrormount.common.errors import BadValue
from mirrormount.common.validation import typed_number

T = TypeVar("T")
_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}(,[0-9]{3})+(\.[0-9]*)?")


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
            except RuntimeError:  # input() without a standard input
                raise EOFError from None
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

    def number(self, question: str, unit: str, least: float, most: float, default: float | None = None) -> float:
        """A number within least … most, repeated with its unit; with a default, an empty answer means that.

        What a comma in it means is asked.
        """

        def parse(answer: str) -> float:
            if not answer and default is not None:
                return float(default)
            meant = self._without_comma(answer) if "," in answer else answer
            try:
                value = typed_number(meant, question)
            except ValueError:
                value = float("nan")
            if not least <= value <= most:
                raise BadValue(f"please give a number within {least:.10g} … {most:.10g}, in {unit}")
            return value

        value = self.until(question if default is None else f"{question} [{default:g}]", parse)
        self.say(f"  = {value:.10g} {unit}")
        return value

    def whole_number(self, question: str, unit: str, least: int, most: int, default: int) -> int:
        """A whole number, as number() asks for one."""
        while True:
            value = self.number(question, unit, least, most, default)
            if value.is_integer():
                return int(value)
            self.say("  please give a whole number")

    def _without_comma(self, answer: str) -> str:
        """The number that is meant by an answer with a comma. Raises BadValue if it is another one."""
        meanings = [answer.replace(",", ".")] if answer.count(",") == 1 and "." not in answer else []
        if _THOUSANDS.fullmatch(answer):
            meanings.append(answer.replace(",", ""))
        for meant in meanings:
            if self.yes(f"A comma: is {answer} the number {meant}?"):
                return meant
        raise BadValue("please give the number without a comma")

    def enter(self, question: str, way_out: str) -> bool:
        """True for Enter alone, False for the word way_out."""

        def parse(answer: str) -> bool:
            if answer not in ("", way_out):
                raise BadValue(f"please press Enter, or type {way_out}")
            return not answer

        return self.until(f"{question} [Enter, or {way_out}]", parse)
