"""The console of a CircuitPython board as a deploy uses it: what is said, and what comes of it."""

import pytest

from mirrormount import errors
from mirrormount.deploy import circuitpython


class Console:
    """A port that answers by a function of all that it has heard; `says` may raise."""

    lockstep = False

    def __init__(self, says) -> None:
        self.says, self.heard, self.waiting = says, b"", b""

    def read(self, timeout_s: float) -> bytes:
        data, self.waiting = self.waiting, b""
        return data

    def write(self, data: bytes) -> None:
        self.heard += data
        self.waiting += self.says(self.heard)

    def close(self) -> None:
        pass


@pytest.fixture
def console(monkeypatch):
    """Puts a console there that answers so."""
    monkeypatch.setattr(circuitpython, "_QUIET_S", 0.0)
    monkeypatch.setattr(circuitpython, "_LAST_WORDS_S", 0.01)
    monkeypatch.setattr(circuitpython, "_START_S", 0.05)
    monkeypatch.setattr(circuitpython, "_PROMPT_S", 0.05)

    def put(says) -> Console:
        port = Console(says)
        monkeypatch.setattr(circuitpython, "open_port", lambda _address: port)
        return port

    return put


def test_a_program_gets_one_ctrl_c_and_time_for_its_finally(console):
    def slow(heard: bytes) -> bytes:
        return b"\r\n>>> " if heard.endswith(b"\r\x02" * 5) else b""

    port = console(slow)
    circuitpython.interrupt("COM3")
    assert port.heard.count(b"\x03") == 1


def test_after_the_end_of_a_program_a_key_brings_the_prompt(console):
    said = b"Press any key to enter the REPL. Use CTRL-D to reload.\r\n"
    port = console(lambda heard: b"\r\nAdafruit CircuitPython 9.2.1\r\n>>> " if b"\x03\r" in heard else said)
    circuitpython.interrupt("COM3")
    assert b"\x04" not in port.heard


def test_a_program_that_does_not_stop_is_told_with_the_remedy(console):
    console(lambda _heard: b"still here\r\n")
    with pytest.raises(errors.DeployError, match="does not stop for Ctrl-C on COM3: nothing was changed"):
        circuitpython.interrupt("COM3")


def test_a_reset_is_the_boards_own_and_a_port_that_goes_is_what_is_expected(console):
    def gone(heard: bytes) -> bytes:
        if b"microcontroller.reset()\r" in heard:
            raise errors.ConnectionLost("COM3 has gone")
        return b">>> "

    port = console(gone)
    circuitpython.reset("COM3")
    assert port.heard.endswith(b"import microcontroller\rmicrocontroller.reset()\r")


def test_why_a_program_ends_is_the_last_line_of_its_error(console):
    traceback = (
        b'Traceback (most recent call last):\r\n  File "code.py", line 3\r\nImportError: no module named "x"\r\n'
    )
    console(lambda heard: traceback if heard.endswith(b"\x04") else b">>> ")
    assert circuitpython.last_words("COM3") == 'ImportError: no module named "x"'
