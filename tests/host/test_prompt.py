"""The way to a board's Python prompt, on a board that is slow to come to it."""

from mirrormount.deploy import prompt
from mirrormount.transport.link import Link


class SlowBoard:
    """A port: a program that takes the first keys on its way out, before the prompt is there."""

    lockstep = False

    def __init__(self, taken: int) -> None:
        self.taken = taken  # of the raw prompt's keys, by the program
        self.said = b""
        self.written = b""

    def write(self, data: bytes) -> None:
        self.written += data
        if data == prompt.RAW:
            self.taken -= 1
            if self.taken < 0:
                self.said += b"raw REPL; CTRL-B to exit\r\n>"

    def read(self, _timeout_s: float) -> bytes:
        said, self.said = self.said, b""
        return said

    def close(self) -> None:
        pass


def test_a_program_that_takes_the_key_of_the_raw_prompt_is_asked_again():
    board = SlowBoard(taken=2)
    works, heard = prompt.takes_programs(Link(board))
    assert works and b"raw REPL" in heard
    assert board.written == prompt.STOP + 3 * prompt.RAW + prompt.FRIENDLY


def test_a_board_without_a_prompt_is_started_again(monkeypatch):
    monkeypatch.setattr(prompt, "_PROMPT_S", 0.0)
    board = SlowBoard(taken=1)
    works, _ = prompt.takes_programs(Link(board))
    assert not works
    assert board.written.endswith(prompt.RESTART)
