"""The line that a long task shows on a terminal."""

import io
import os
import struct

import pytest

from mirrormount.terminal import StatusLine

termios = pytest.importorskip("termios")
fcntl = pytest.importorskip("fcntl")


@pytest.fixture
def terminal(monkeypatch):
    """A terminal of so many columns as stderr; returns what was written to it."""
    ends = []

    def of_columns(columns):
        leader, follower = os.openpty()
        fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        ends.append(os.fdopen(follower, "w", encoding="utf-8"))
        monkeypatch.setattr("sys.stderr", ends[-1])
        return lambda: os.read(leader, 10_000).decode()

    yield of_columns
    for end in ends:
        end.close()


def test_a_status_line_never_wraps_since_only_its_last_row_would_be_written_over(terminal):
    shown = terminal(40)
    line = StatusLine()
    line.show("  5%, 8.4 min left  x: 60 steps, positive  (Ctrl-C stops and keeps what was measured)")
    assert shown() == "\r  5%, 8.4 min left  x: 60 steps, posit…\x1b[K"
    line.show("x" * 39)
    assert shown() == "\r" + "x" * 39 + "\x1b[K"


def test_a_terminal_that_does_not_tell_its_size_gets_the_whole_line(terminal):
    shown = terminal(0)
    StatusLine().show("y" * 100)
    assert shown() == "\r" + "y" * 100 + "\x1b[K"


def test_in_a_notebook_one_line_of_the_cell_is_written_over(monkeypatch):
    cell = type("OutStream", (io.StringIO,), {"__module__": "ipykernel.iostream"})()
    monkeypatch.setattr("sys.stdout", cell)
    line = StatusLine()
    for text in ("10 %, a long phase", "20 %", "20 %", "z" * 200):
        line.show(text)
    line.end()
    # a notebook overwrites characters and knows no code that clears a line: the rest is blanks
    longest = "z" * 98 + "…"
    assert cell.getvalue() == f"\r10 %, a long phase\r20 %{' ' * 14}\r{longest}\r{' ' * 99}\r"
