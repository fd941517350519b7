"""A client that comes, writes and leaves a virtual board while another one is served."""

import socket
from pathlib import Path

import pytest
from served import wait_for

from mirrormount.device.mount import Mount


def write_and_leave(address: str | Path, data: bytes) -> None:
    if isinstance(address, Path):
        address.write_bytes(data)
        return
    with socket.create_connection(("127.0.0.1", int(address.rsplit(":", 1)[1]))) as raw:
        raw.sendall(data)


@pytest.mark.parametrize("way", ["pty", "tcp"])
def test_what_a_client_wrote_that_was_never_served_is_not_obeyed_later(board, way):
    with Mount.open(board.tcp) as mount:
        write_and_leave(board.link if way == "pty" else board.tcp, b"02550255")
        assert not mount.status().moving
    with Mount.open(board.tcp) as mount:
        assert not mount.status().moving
    assert board.edges() == []


@pytest.mark.parametrize("way", ["pty", "tcp"])
def test_a_stop_of_such_a_client_counts(board, way):
    with socket.create_connection(("127.0.0.1", int(board.tcp.rsplit(":", 1)[1]))) as raw:
        raw.sendall(b"1XM60000\n02550000")
        wait_for(board.driving, "the motor to run")
        write_and_leave(board.link if way == "pty" else board.tcp, b"02550255!")
    wait_for(lambda: not board.driving(), "the stop")
