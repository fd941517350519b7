"""What a long task says of itself on stderr: a bar on a terminal, else a line for each phase. Imports nothing."""

import os
import sys

_WIDTH = 24


class StatusLine:
    """One line on a terminal that is written over and over: show() and, when the task is over, end().

    A text that is wider than the terminal is cut: the end of a wrapped line alone would be written over. Where stderr
    is no terminal nothing is shown.
    """

    def __init__(self) -> None:
        self._out = sys.stderr
        self._terminal = bool(self._out and self._out.isatty())
        self._shown = ""

    def show(self, text: str) -> None:
        """Show this instead of what was shown."""
        if self._terminal and text != self._shown:
            print(f"\r{self._cut(text)}\x1b[K", end="", file=self._out, flush=True)
            self._shown = text

    def _cut(self, text: str) -> str:
        try:
            columns = os.get_terminal_size(self._out.fileno()).columns
        except (OSError, ValueError):  # a terminal without a size, or no file
            columns = 0
        return f"{text[: columns - 2]}…" if 2 < columns <= len(text) else text

    def end(self) -> None:
        """Clear the line."""
        if self._shown:
            print("\r\x1b[K", end="", file=self._out, flush=True)
            self._shown = ""


class Progress:
    """phase() for each part of the task, bar() within one, end() when the bar is over."""

    def __init__(self) -> None:
        self._out = sys.stderr
        self._terminal = bool(self._out and self._out.isatty())
        self._shown = False

    def phase(self, what: str) -> None:
        """A part of the task begins."""
        self.end()
        if self._out:
            print(what, file=self._out, flush=True)

    def bar(self, done: int, of: int, what: str) -> None:
        """done of `of` parts are over, now comes `what`."""
        if self._terminal and of:
            full = _WIDTH * done // of
            text = f"[{'#' * full}{'-' * (_WIDTH - full)}] {done}/{of} {what}"
            print(f"\r{text}\x1b[K", end="", file=self._out, flush=True)
            self._shown = True

    def end(self) -> None:
        """Clear the bar."""
        if self._shown:
            print("\r\x1b[K", end="", file=self._out, flush=True)
            self._shown = False
