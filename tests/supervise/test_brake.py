"""The brake, where it meets a port that another thread closes."""

import os

import pytest

from mirrormount.errors import ConnectionLost
from mirrormount.transport.ports import SerialPort


@pytest.mark.skipif(os.name != "posix", reason="a pty needs POSIX")
def test_a_stop_that_meets_a_port_just_closed_by_another_thread_finds_it_gone():
    controller, terminal = os.openpty()
    port = SerialPort(os.ttyname(terminal))
    fd, port._serial.fd = port._serial.fd, None  # as in the middle of close()
    with pytest.raises(ConnectionLost):
        port.write(b"!\n")
    port._serial.fd = fd
    port.close()
    os.close(controller)
    os.close(terminal)
