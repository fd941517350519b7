"""What a long task says of itself on stderr: a bar on a terminal, else a line for each phase."""

import sys

_WIDTH = 24


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
