"""The ports of a virtual board: what of a flood is before a stop, and what is left of a client that goes."""

import contextlib
import os
import socket
import threading

import pytest
from served import PATIENCE_S, wait_for

from mirrormount.serve import Client
from mirrormount_sim import ports
from mirrormount_sim.ports import BUFFER, PtyPort, TcpPort


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
    wait_for(lambda: port.take(0) == b"" and stop in port._waiting.bytes, "the stop to arrive")
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
    monkeypatch.setattr(ports, "WAITING_MOST", 10_000)
    client.sendall(b"02550255" * 5000)
    wait_for(lambda: port.take(0) == b"" and port.waits and port._ended, "too much to have come")
    assert received(port) == b"!\n" and not port.connected()


def test_a_browser_is_closed_and_leaves_nothing(port, client):
    client.sendall(b"POST / HTTP/1.1\r\n\r\n1MV+\n")
    wait_for(lambda: port.take(100) == b"" and not port.connected(), "the browser to be closed")


@pytest.mark.parametrize("stop", [b"!", b"00000000", b"\x03"])
def test_on_a_pty_too_a_stop_overtakes_what_the_board_has_no_room_for(stop):
    port = PtyPort()
    client = os.open(port.address, os.O_RDWR | os.O_NOCTTY)
    flood = b"02550255" * 20_000 + stop

    def write_all() -> None:
        at = 0
        while at < len(flood):
            at += os.write(client, flood[at:])

    writer = threading.Thread(target=write_all)
    writer.start()
    try:
        wait_for(lambda: port.take(0) == b"" and stop in port._waiting.bytes, "the stop to arrive")
        assert port.take(BUFFER).startswith(b"!\n" + stop)
    finally:
        writer.join()
        os.close(client)
        port.close()


def test_more_than_can_wait_on_a_pty_is_void_and_stops_the_motors(monkeypatch):
    monkeypatch.setattr(ports, "WAITING_MOST", 10_000)
    port = PtyPort()
    client = os.open(port.address, os.O_RDWR | os.O_NOCTTY)
    flood = b"02550255" * 5000

    def write_all() -> None:
        at = 0
        with contextlib.suppress(OSError):  # the port is closed before all is written
            while at < len(flood):
                at += os.write(client, flood[at:])

    writer = threading.Thread(target=write_all)
    writer.start()
    try:
        wait_for(lambda: port.take(0) == b"" and port._waiting.bytes.startswith(b"!?"), "too much to have come")
    finally:
        port.close()
        writer.join()
        os.close(client)


def test_python_that_is_pasted_at_the_prompt_of_a_pty_is_left_as_it_is():
    port = PtyPort()
    client = os.open(port.address, os.O_RDWR | os.O_NOCTTY)
    source = b"a != b #" * 200
    try:
        os.write(client, source)
        taken = b""
        while len(taken) < len(source):
            taken += port.take(100, at_prompt=True)
        assert taken == source
    finally:
        os.close(client)
        port.close()


class Endless:
    """A client that sends for ever what the board does not get."""

    def __init__(self) -> None:
        self.received = 0

    def recv(self, most: int) -> bytes:
        self.received += most
        assert self.received < 1 << 25, "nobody else has a turn"
        return b"\x01" * most

    def setblocking(self, _flag: bool) -> None:
        pass

    def setsockopt(self, *_: int) -> None:
        raise OSError


def test_a_client_that_never_ends_does_not_keep_the_others_waiting(port):
    port._receive(Client(Endless()))
    assert port.take(BUFFER) == b""
