"""The parser of the command line and of each command: no abbreviations, and each fault with its own command's usage."""

import argparse
import sys
from collections.abc import Sequence
from typing import Any


class Parser(argparse.ArgumentParser):
    """A parser that takes no part of an option for the option: what turns a motor is written in full.

    Its subparsers are of this class, too, so an argument that a command does not know is told with that command's
    usage, not with that of the whole.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False)

    def parse_known_args(self, *given: Any, **named: Any) -> Any:
        """As argparse's, but nothing is left that nobody knows."""
        found, unknown = super().parse_known_args(*given, **named)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}{self._in_full(unknown)}")
        return found, unknown

    def _in_full(self, unknown: Sequence[str]) -> str:
        """The options of which an unknown word is the beginning, to follow an error; "" if there are none."""
        begun = [word.partition("=")[0] for word in unknown if word.startswith("--")]
        meant = [name for name in self._option_string_actions if any(name.startswith(word) for word in begun)]
        return f" (an option is written in full: {' or '.join(meant)})" if meant else ""


class WholeParser(Parser):
    """The parser of the whole command line."""

    def parse_known_args(self, *given: Any, **named: Any) -> Any:
        """As Parser's. An option that stands before its command is told as such."""
        words = sys.argv[1:] if not given or given[0] is None else given[0]
        option = words[0].partition("=")[0] if words else ""
        if option.startswith("--") and option not in self._option_string_actions:
            self.error(f"{option} stands behind the command: mirrormount COMMAND {option}")
        return super().parse_known_args(*given, **named)

    def add_subparsers(self, **options: Any) -> Any:
        """As argparse's: for commands, which are plain parsers."""
        return super().add_subparsers(parser_class=Parser, **options)
