"""The board that comes and goes is always the same one."""

import pytest

from mirrormount.errors import ConnectionLost, NotAMount
from mirrormount.supervise.connection import Connection
from mirrormount.supervise.log import WireLog
from mirrormount.transport.ports import Port, open_port


class Labelled:
    """A virtual board whose answer to *IDN? is another one."""

    def __init__(self, identity: bytes) -> None:
        self._port, self._identity, self._line = open_port("virtual://"), identity, b""
        self.lockstep = self._port.lockstep
        self.write, self.close = self._port.write, self._port.close

    def read(self, timeout_s: float) -> bytes:
        *lines, self._line = (self._line + self._port.read(timeout_s)).split(b"\n")
        return b"".join((self._identity if b"mirrormount," in line else line) + b"\n" for line in lines)


def reopened(first: bytes, second: bytes) -> Connection:
    """A connection that has lost its first board; the second one is at the port now."""
    boards = [first, second]

    def at_the_port() -> Port:
        return Labelled(boards.pop(0))

    connection = Connection(at_the_port, WireLog(), lambda: None)
    connection.open()
    connection.lose(ConnectionLost("unplugged"))
    return connection


@pytest.mark.parametrize("other", [b"mirrormount,PICO,00ff,0.3", b"mirrormount,PICO2,00fe,0.3"])
def test_another_board_is_not_driven_in_the_place_of_the_one_that_was_lost(other):
    connection = reopened(b"mirrormount,PICO,00fe,0.3", other)
    with pytest.raises(NotAMount, match="another board"):
        connection.open()
    assert connection.mount is None
    assert other.decode() in connection.trouble


def test_the_same_board_with_newer_firmware_is_driven_again():
    connection = reopened(b"mirrormount,PICO,00fe,0.3", b"mirrormount,PICO,00fe,0.4")
    assert connection.open().board_id == "00fe"
    connection.close()
