"""The log of the wire."""

from mirrormount.supervise.log import WireLog
from mirrormount.transport.ports import TappedPort


class Port:
    """A port that says what it is given to say."""

    lockstep = False

    def __init__(self, *says: bytes) -> None:
        self.says = list(says)
        self.heard = b""

    def read(self, timeout_s: float) -> bytes:
        return self.says.pop(0) if self.says else b""

    def write(self, data: bytes) -> None:
        self.heard += data

    def close(self) -> None:
        pass


def lines(log: WireLog) -> list[tuple[bool, str]]:
    return [(entry.to_board, entry.text) for entry in log.since(0)]


def test_lines_of_both_directions_are_kept_whole_and_in_order():
    log = WireLog()
    port = TappedPort(Port(b"mirrormount,", b"Pico\r\n"), log)
    port.write(b"*IDN?\n")
    assert port.read(1) + port.read(1) == b"mirrormount,Pico\r\n"
    assert lines(log) == [(True, "*IDN?"), (False, "mirrormount,Pico")]


def test_what_is_not_ascii_is_shown_and_not_lost():
    log = WireLog()
    log.add(b"\xff\x03\n", to_board=False)
    assert lines(log) == [(False, "\\xff\x03")]


def test_a_line_without_end_is_not_kept_for_ever():
    log = WireLog()
    for _ in range(1000):
        log.add(b"x" * 100, to_board=False)
    assert len(log.since(0)) > 100


def test_the_panels_own_questions_are_marked():
    log = WireLog()
    log.add(b"XS?\n", to_board=True)
    log.add(b"1,2,0|0,0,0,0,0,0|0,0,0,0,0,0\r\n", to_board=False)
    log.add(b"2PR5\n", to_board=True)
    assert [entry.poll for entry in log.since(0)] == [True, True, False]


def test_only_what_came_after_a_number_is_told_again():
    log = WireLog()
    log.add(b"1\n2\n3\n", to_board=True)
    assert [entry.text for entry in log.since(2)] == ["3"]
