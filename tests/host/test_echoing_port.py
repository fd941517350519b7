"""A board on a terminal in its default mode, held open by one program while another writes; judged by pin edges."""

import itertools
import os
import select
import subprocess
import sys

import pytest
from served import ServedBoard, wait_for

termios = pytest.importorskip("termios")
fcntl = pytest.importorskip("fcntl")

from mirrormount.transport.ports import open_port  # noqa: E402

# a board drops what returns up to a gap of its own time, which is this computer's
pytestmark = pytest.mark.wall_clock


class Cooked:
    """The port in the mode of `stty sane`, open in this process; other programs write to it."""

    def __init__(self, board: ServedBoard) -> None:
        self.board = board
        self.fd = os.open(board.link, os.O_RDWR | os.O_NOCTTY)
        mode = termios.tcgetattr(self.fd)
        mode[0] = termios.BRKINT | termios.ICRNL | termios.IXON
        mode[1] = termios.OPOST | termios.ONLCR
        mode[3] = termios.ECHO | termios.ECHOE | termios.ECHOK | termios.ECHOCTL | termios.ICANON | termios.ISIG
        termios.tcsetattr(self.fd, termios.TCSANOW, mode)

    def write(self, data: bytes) -> None:
        """Have another program write this and end."""
        code = "import os, sys; os.write(os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY), os.fsencode(sys.argv[2]))"
        subprocess.run([sys.executable, "-c", code, str(self.board.link), os.fsdecode(data)], check=True)

    def ask(self, command: bytes, like: bytes) -> bytes:
        """The first answer with this in it. It goes back to the board, too, so that a question may be dropped."""
        text = b""

        def answer() -> bytes:
            nonlocal text
            os.write(self.fd, command)
            while select.select([self.fd], [], [], 0.2)[0]:
                text += os.read(self.fd, 4096)
            return next((line for line in text.splitlines() if like in line), b"")

        found = wait_for(answer, f"an answer to {command!r}")
        assert isinstance(found, bytes)
        return found

    def pass_a_second(self) -> None:
        """Wait until the board's own clock has gone on by a second."""
        since_ms = self._uptime_ms()
        wait_for(lambda: self._uptime_ms() - since_ms >= 1_000, "a second of the board's time")

    def _uptime_ms(self) -> int:
        return int(self.ask(b"XS?\n", b"|").split(b",")[1])

    def close(self) -> None:
        os.close(self.fd)


def rises(board: ServedBoard, pin: str) -> int:
    """How often this enable went from off to on."""
    duties = [0] + [edge["duty"] for edge in board.edges() if edge["pin"] == pin]
    return sum(1 for before, after in itertools.pairwise(duties) if after and not before)


@pytest.mark.parametrize("machine", ["cpython", "micropython"])
def test_a_reply_on_a_cooked_terminal_drives_nothing(serve, machine):
    board = serve("--machine", machine)
    port = Cooked(board)
    try:
        for count, end in enumerate((b"", b"\n", b"\r\n"), 1):
            port.write(b"02550000" + end)
            wait_for(lambda count=count: rises(board, "m1_en") == count, "the frame to drive once")
            wait_for(lambda: not board.driving(), "the own reply to stop it")
            port.write(b"!")
            port.pass_a_second()
            assert rises(board, "m1_en") == count, end
            assert rises(board, "m2_en") == 0
        assert port.ask(b"TB?\n", b"60, ") == b"60, MALFORMED INPUT: MOTORS STOPPED"
    finally:
        port.close()


def test_an_answer_that_is_a_frame_drives_nothing_on_a_cooked_terminal(board):
    port = Cooked(board)
    try:
        port.write(b"1SL?\n")
        port.pass_a_second()
        assert board.edges() == []
    finally:
        port.close()


def test_the_host_opens_a_cooked_port_raw_and_for_itself(board):
    cooked = Cooked(board)
    try:
        port = open_port(str(board.link))
        try:
            iflag, oflag, _, lflag = termios.tcgetattr(cooked.fd)[:4]
            assert not lflag & (termios.ECHO | termios.ICANON | termios.ISIG)
            assert not iflag & (termios.ICRNL | termios.INLCR | termios.IGNCR | termios.IXON)
            assert not oflag & termios.OPOST
            with pytest.raises(BlockingIOError):  # flock: pyserial's `exclusive`
                fcntl.flock(cooked.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        finally:
            port.close()
    finally:
        cooked.close()
