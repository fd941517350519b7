"""What a command prints and how it ends: safe text, progress, signals, and other commands to start.

Text from outside (a board, a drive, a file, a network) goes through printable(). A long task shows a line or a bar, on
a terminal or in a notebook's cell. A signal that ends a program becomes an exception, so that motors are stopped
on the way.
"""

import contextlib
import os
import re
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import weakref

NETWORK = ("http", "https", "rtsp")  # schemes of a camera's address that may hold a password
_CLEAR = re.compile(r"([^/?#@]*@)?(?P<host>[^/?#@]+)(?P<path>/[^?#@]*)?([?#][^@]*)?")


def printable(text: str, longest: int = 200) -> str:
    r"""One line in which nothing controls a terminal: other characters appear as escapes, for instance `\x1b`.

    Control characters, line breaks, marks that turn the direction of text and unpaired surrogates are escaped.
    A text of more than `longest` characters ends in an ellipsis.
    """
    kept = text if len(text) <= longest else text[: longest - 1] + "…"
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode("ascii") for c in kept)


def without_credentials(address: str) -> str:
    """A camera's address as it may be shown: without user and password, and of the network without what follows a ?.

    An address that does not show for certain what in it is a password is not shown at all.
    """
    scheme, mark, rest = address.partition("://")
    if not mark or (scheme.lower() not in NETWORK and "@" not in rest):  # a scheme may be mistyped
        return address
    clear = _CLEAR.fullmatch(rest)
    if not clear:
        return f"{scheme}://…"
    path = clear["path"] or ""
    return f"{scheme}://{clear['host']}{'/…' if '=' in path else path}"


# ---- progress

_WIDTH = 24  # characters of a bar
_CELL = 100  # columns of a notebook's cell


class StatusLine:
    """One line that is written over and over: show() and, when the task is over, end().

    It is on stderr if that is a terminal, and in a notebook in the output of the cell; elsewhere nothing is shown. A
    text that is wider than the terminal is cut: the end of a wrapped line alone would be written over.
    """

    def __init__(self) -> None:
        self._in_notebook = type(sys.stdout).__module__.partition(".")[0] == "ipykernel"
        self._out = sys.stdout if self._in_notebook else sys.stderr
        self._seen = self._in_notebook or bool(self._out and self._out.isatty())
        self._shown = ""

    def show(self, text: str) -> None:
        """Show this instead of what was shown."""
        if self._seen and (text := self._cut(text)) != self._shown:
            self._write(text)
            self._shown = text

    def _write(self, text: str) -> None:
        # a notebook overwrites characters, and knows no code that clears the rest of a line
        rest = " " * (len(self._shown) - len(text)) if self._in_notebook else "\x1b[K"
        print(f"\r{text}{rest}", end="", file=self._out, flush=True)

    def _cut(self, text: str) -> str:
        try:
            columns = _CELL if self._in_notebook else os.get_terminal_size(self._out.fileno()).columns
        except (OSError, ValueError):  # a terminal without a size, or no file
            columns = 0
        return f"{text[: columns - 2]}…" if 2 < columns <= len(text) else text

    def end(self) -> None:
        """Clear the line."""
        if self._shown:
            self._write("")
            if self._in_notebook:
                print("\r", end="", file=self._out, flush=True)
            self._shown = ""


class Progress:
    """phase() for each part of the task, bar() within one, end() when the bar is over."""

    def __init__(self) -> None:
        self._line = StatusLine()

    def phase(self, what: str) -> None:
        """A part of the task begins."""
        self.end()
        if sys.stderr:
            print(what, file=sys.stderr, flush=True)

    def bar(self, done: int, of: int, what: str) -> None:
        """done of `of` parts are over, now comes `what`."""
        if of:
            full = _WIDTH * done // of
            self._line.show(f"[{'#' * full}{'-' * (_WIDTH - full)}] {done}/{of} {what}")

    def end(self) -> None:
        """Clear the bar."""
        self._line.end()


# ---- a notebook's cells


def on_interrupted_cell(action: "weakref.WeakMethod[Callable[[], object]]") -> None:
    """From now on action() runs after a cell that was interrupted, whatever it was waiting for; elsewhere never."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is None:
        return

    def ended(result: Any) -> None:
        call = action()
        if call is None:
            shell.events.unregister("post_run_cell", ended)
        elif isinstance(result.error_in_exec, KeyboardInterrupt):
            call()

    shell.events.register("post_run_cell", ended)


# ---- signals

NAMES = ("SIGTERM", "SIGHUP")


class Terminated(BaseException):
    """A signal asks this program to end. Like KeyboardInterrupt it is no Exception; number is the signal's."""

    def __init__(self, number: int) -> None:
        super().__init__(f"ended by {signal.Signals(number).name}")
        self.number = number


@contextlib.contextmanager
def ended_in_order() -> Iterator[None]:
    """SIGTERM and SIGHUP raise Terminated within this, in the main thread; further ones are ignored from then on.

    A signal that was ignored before (nohup) stays so. The earlier handlers are restored afterwards.
    """
    numbers = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    before = {number: handler for number, handler in before.items() if handler not in (signal.SIG_IGN, None)}

    def end(number: int, _frame: FrameType | None) -> None:
        for every in before:
            signal.signal(every, signal.SIG_IGN)  # systemd sends both: the second must not interrupt the stop
        raise Terminated(number)

    for number in before:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# ---- other commands


def install_command(extra: str) -> str:
    """The command that installs an extra: from the copy of the repository that this package belongs to, if it does.

    It is for the Python that runs: a bare `pip` may be another one's.
    """
    copy = Path(__file__).parents[2]
    if (copy / "pyproject.toml").is_file():
        return f'{_this_python()} -m pip install -e "{copy}[{extra}]"'
    return f'in a copy of the repository: {_this_python()} -m pip install ".[{extra}]"'


def _this_python() -> str:
    """The Python that runs, as a shell is told it: `python` if that is found first, else its path."""
    here, found = sys.executable or "python", shutil.which("python")
    if found and os.path.normcase(os.path.abspath(found)) == os.path.normcase(os.path.abspath(here)):
        return "python"
    if Path(here).is_relative_to(Path.cwd()):
        here = str(Path(here).relative_to(Path.cwd()))
    return f'"{here}"' if " " in here else here


def python_module(name: str, *arguments: str) -> list[str]:
    """The command that runs an installed module as `python -m name` would.

    -P: without it Python searches the current folder first, where a file of that name would be run instead.
    """
    return [sys.executable, "-P", "-m", name, *arguments]
