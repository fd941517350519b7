"""What goes between a network client and a board: how much at a time, what keeps motion alive, whose answers."""

import pytest

from mirrormount.serve import Relay

REST = b"1,2,0|0,0,0,0,1,0|0,0,0,0,1,0\r\n"
MOVES = b"1,2,0|0,1,1,0,0,0|0,0,0,0,1,0\r\n"
QUERY = b"01>XS?\n"
DAMAGE = b"\x7f\n"


class Board:
    """Takes what a relay sends, and answers its queries when the test says so."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.taken = b""
        self.relay = Relay(self._take, lambda: self.now_s)
        self._answered = 0

    def _take(self, data: bytes) -> None:
        self.taken += data

    def sent(self, *pieces: bytes) -> bytes:
        """What the board gets when the client sends these pieces."""
        before = len(self.taken)
        for piece in pieces:
            self.relay.from_client(piece)
        return self.taken[before:]

    def answers(self, status: bytes = REST) -> bytes:
        """The board answers all queries of the relay; what of it the client sees."""
        queries = self.taken[self._answered :].count(QUERY)
        self._answered = len(self.taken)
        return self.relay.from_board((b"01>" + status) * queries)

    def passes(self, seconds: float, *, answers: bytes | None = None) -> bytes:
        """What the board gets while time passes."""
        before = len(self.taken)
        end = self.now_s + seconds
        while self.now_s < end - 1e-9:
            self.now_s += 0.01
            self.relay.pump()
            if answers:
                self.answers(answers)
        return self.taken[before:]


@pytest.fixture
def board():
    return Board()


def test_a_flood_waits_here_and_not_on_its_way_to_the_board(board):
    assert len(board.sent(b"02550255" * 10_000)) <= 1024
    assert b"0255" not in board.passes(0.3)
    before = len(board.taken)
    assert board.answers() == b""
    board.relay.pump()
    assert 256 < len(board.taken) - before <= 1024


@pytest.mark.parametrize("stop", [[b"!"], [b"00000000"], [b"0000", b"0000"]])
def test_a_stop_behind_a_flood_goes_at_once_and_voids_what_waits(board, stop):
    board.sent(b"02550255" * 10_000)
    assert b"!\n" in (went := board.sent(*stop)) and b"0255" not in went


def test_a_board_that_drops_an_answer_is_not_waited_for_for_ever(board):
    board.sent(b"02550255" * 1000)
    before = len(board.taken)
    board.passes(0.6)
    assert len(board.taken) > before


@pytest.mark.parametrize(
    ("pieces", "goes"),
    [
        ([b"1T"], b""),  # only whole messages go
        ([b"1T", b"P?\n2", b"TP?\r"], b"1TP?\n2TP?\r"),
        ([b"0000", b"0255"], b"XK500\n00000255"),
        ([b"1XM60000\n!2DH7\n"], b"1XM60000\n!\n2DH7\n"),  # what stands right before a stop goes with it
        ([b"1PR5!00\n1TP?\n"], b"!\n1TP?\n"),  # the rest of a message that a stop has cut is not executed
        ([b"+0000000", b"0"], b"+0000000!\n"),  # eight zeros, though no message ends there
        ([b"+0000000", b"0", b"0000000"], b"+0000000!\n00000000"),
        ([b"1@\n1TP?\n"], DAMAGE + b"1TP?\n"),  # the board refuses it, and stops
        ([b"1P?R5;2MV+\n1TP?\n"], DAMAGE + b"1TP?\n"),
        ([b"x" * 200, b"\n1TP?\n"], DAMAGE + b"1TP?\n"),
        ([b"\r\n \0"], b"\r\n \0"),
    ],
)
def test_what_goes_to_the_board(board, pieces, goes):
    assert board.sent(*pieces) == goes


@pytest.mark.parametrize(("begun", "after_s"), [(b"1PR", 1.0), (b"025", 0.05)])
def test_a_message_that_is_not_finished_is_damage(board, begun, after_s):
    assert board.sent(begun) == b""
    assert board.passes(after_s - 0.02) == b""
    assert board.passes(0.05) == DAMAGE
    assert board.sent(b"5\n") == DAMAGE


@pytest.mark.parametrize(
    "motion", [b"1PR5\n", b"1MV+\n", b"02550000", b"2PA7;1TP?\n", b"1XU9000\n", b"1OR\n", b"2MT-\n"]
)
def test_what_starts_a_motion_takes_a_keep_alive_with_it_which_is_fed(board, motion):
    assert board.sent(motion) in (motion + b"XK500\n", b"XK500\n" + motion)
    assert 8 <= board.passes(1, answers=MOVES).count(QUERY) <= 10
    board.passes(0.2, answers=REST)
    assert board.passes(1) == b""


@pytest.mark.parametrize("line", [b"1TP?\n", b"1PR?\n", b"*IDN?\n", b"1VA5\n", b"00000000", b"ST\n"])
def test_what_starts_no_motion_takes_none(board, line):
    assert board.sent(line) == line
    assert board.passes(1) == b""


def test_a_short_keep_alive_of_a_client_is_fed_by_that_client_alone(board):
    assert board.sent(b"XK300;1MV+\n") == b"XK300;1MV+\n"
    assert board.passes(0.3, answers=MOVES) == b""


def test_a_long_one_is_fed_for_it_as_long_as_it_lasts(board):
    assert board.sent(b"XK5000;1MV+\n") == b"XK5000;1MV+\nXK500\n"
    assert board.passes(4.5, answers=MOVES).count(QUERY) > 35
    assert board.passes(0.2, answers=MOVES).count(QUERY) <= 2
    assert board.passes(0.4) == b""


@pytest.mark.parametrize("pause_s", [0.0, 0.009, 0.05, 0.29])
def test_a_motion_behind_a_keep_alive_that_may_be_over_has_one(board, pause_s):
    board.sent(b"XK%d\n" % max(10, 1000 * pause_s))
    board.now_s += pause_s
    assert b"XK500\n" in board.sent(b"02550000")


@pytest.mark.parametrize("line", [b"XK0\n", b"*RST\n"])
def test_a_keep_alive_that_is_switched_off_is_followed_by_one_of_the_relay(board, line):
    board.sent(b"XK300;1MV+\n")
    assert board.sent(line) == line + b"XK500\n"


def test_answers_to_queries_of_the_relay_are_taken_out_and_no_others(board):
    board.sent(b"1MV+\n")
    board.passes(0.15)
    assert board.relay.from_board(b"7\r\n01>" + MOVES + b"1>8\r\n01") == b"7\r\n1>8\r\n"
    assert board.relay.from_board(b"9\r\n") == b"019\r\n"


def test_an_answer_from_before_a_motion_does_not_end_its_keep_alive(board):
    board.sent(b"1MV+\n")
    board.passes(0.1)
    board.sent(b"2MV+\n")
    board.answers(REST)
    assert board.relay.moving
    board.passes(0.2, answers=REST)
    assert not board.relay.moving


@pytest.mark.parametrize(
    ("pieces", "goes_on"),
    [
        ([b"1PR20\n"], True),
        ([b"XK300;1PR20\n"], True),
        ([b"1MV+\n"], False),
        ([b"02550255"], False),
        ([b"1PR20;2MV+\n"], False),
        ([b"1TP?\n"], False),
        ([], False),
        ([b"1PR20\n", b"2PR"], False),
        ([b"1PR20\n" + b"02550255" * 1000], False),
    ],
)
def test_when_the_client_leaves_moves_with_an_end_go_on_where_that_is_wanted(board, pieces, goes_on):
    board.sent(*pieces)
    before = len(board.taken)
    assert board.relay.client_left(finish=True) == goes_on
    assert (b"!" in board.taken[before:]) != goes_on
    assert not board.relay.settled
    board.answers(MOVES)
    assert board.relay.settled
    assert board.passes(2, answers=MOVES).count(QUERY) >= 18


def test_when_the_client_leaves_all_stops_unless_something_else_is_wanted(board):
    board.sent(b"1PR20\n")
    assert not board.relay.client_left(finish=False)
    assert b"!\n" in board.taken


@pytest.mark.parametrize("tail", [b"\r\n02550000\r\n255\r\n0\r\n255\r\n0\r\n", b"\r\n0255", b"\r\n0255!02550000\r\n"])
def test_a_reply_that_a_clients_port_returns_drives_nothing_and_what_comes_after_a_silence_does(board, tail):
    board.sent(b"02550000")
    assert b"0255" not in board.sent(b"#", *(bytes((c,)) for c in tail))
    board.passes(0.06)
    assert board.sent(b"02550000").endswith(b"02550000")
