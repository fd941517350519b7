"""What a deploy answers to a stop. test_deploy.py has the whole way."""

import pytest

from mirrormount.common.errors import MountError
from mirrormount.deploy.stop_answer import StopAnswer
from mirrormount.transport.lines import Link
from mirrormount.transport.stop_socket import SENT, STOPPED


class Port:
    """Notes what is written."""

    lockstep = False

    def __init__(self) -> None:
        self.written = b""

    def write(self, data: bytes) -> None:
        self.written += data


def test_before_the_firmware_was_found_at_rest_the_stop_is_written_even_if_the_exchange_hangs():
    answer, port = StopAnswer(), Port()
    link = Link(port)  # pyright: ignore[reportArgumentType]
    answer.asking(link)
    with link.lock:
        assert (answer.stop(), port.written) == (SENT, b"!\n")


def test_at_rest_nothing_is_written_into_the_prompt():
    answer, port = StopAnswer(), Port()
    answer.asking(Link(port))  # pyright: ignore[reportArgumentType]
    answer.found(at_rest=True)
    assert (answer.stop(), port.written) == (STOPPED, b"")


def test_of_somebody_elses_program_no_stop_is_claimed():
    answer = StopAnswer()
    answer.asking(Link(Port()))  # pyright: ignore[reportArgumentType]
    answer.found(at_rest=False)
    with pytest.raises(MountError, match="no firmware that takes a stop"):
        answer.stop()
