"""The TCP port of a virtual board: what of a flood is before a stop, and what is left of a client that goes."""

import socket

import pytest
from served import PATIENCE_S, wait_for

from mirrormount.virtual import ports
from mirrormount.virtual.ports import BUFFER, TcpPort


@pytest.fixture
def port():
    here = TcpPort(0)
    yield here
    here.close()


@pytest.fixture
def client(port):
    connection = socket.create_connection(("127.0.0.1", int(port.address.rsplit(":", 1)[1])), PATIENCE_S)
    wait_for(lambda: port.watched() and port.connected(), "the client to be let in")
    yield connection
    connection.close()


def received(port: TcpPort) -> bytes:
    """All that the board gets, as much at a time as it has room for."""
    taken = b""
    while data := port.take(BUFFER):
        taken += data
    return taken


@pytest.mark.parametrize("stop", [b"!", b"00000000"])
def test_what_is_before_a_stop_in_a_flood_fits_into_the_boards_buffer(port, client, stop):
    client.sendall(b"02550255" * 50_000 + stop)
    wait_for(lambda: port.take(0) == b"" and stop in port._waiting, "the stop to arrive")
    taken = received(port)
    assert taken.index(b"!\n") == 0 and b"0255" not in taken


def test_what_a_client_sends_before_it_goes_is_obeyed(port, client):
    client.sendall(b"1XM700\n02550000")
    client.close()
    taken = b""

    def all_there() -> bool:
        nonlocal taken
        taken += port.take(4)
        return not port.connected()

    wait_for(all_there, "the client to be gone")
    assert taken == b"1XM700\n02550000"


def test_a_client_that_sends_more_than_can_wait_is_closed_with_a_stop(port, client, monkeypatch):
    monkeypatch.setattr(ports, "_WAITING_MOST", 10_000)
    client.sendall(b"02550255" * 5000)
    wait_for(lambda: port.take(0) == b"" and port.waits and port._ended, "too much to have come")
    assert received(port) == b"!\n" and not port.connected()


def test_a_browser_is_closed_and_leaves_nothing(port, client):
    client.sendall(b"POST / HTTP/1.1\r\n\r\n1MV+\n")
    wait_for(lambda: port.take(100) == b"" and not port.connected(), "the browser to be closed")
