"""Text from outside cannot control the terminal on which it is printed."""

import pytest

from mirrormount.terminal import printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Raspberry Pi Pico", "Raspberry Pi Pico"),
        ("2 µm … 🔬", "2 µm … 🔬"),
        ("\x1b[2J\x1b]0;title\x07", r"\x1b[2J\x1b]0;title\x07"),
        ("\x9b31m", r"\x9b31m"),
        ("one\r\ntwo\tthree", r"one\r\ntwo\tthree"),
        ("right\u202eleft\u2066", r"right\u202eleft\u2066"),
        ("half\udce9", r"half\udce9"),
        ("\u2028", r"\u2028"),
    ],
)
def test_what_controls_a_terminal_is_shown_as_an_escape(text, shown):
    assert printable(text) == shown
    assert printable(text).isprintable()


def test_a_long_text_is_cut_and_shows_it():
    assert printable("x" * 5000) == "x" * 199 + "…"
    assert printable("x" * 200) == "x" * 200
