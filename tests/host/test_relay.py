"""What goes between a network client and a board: how much at a time, what keeps motion alive, whose answers."""

import pytest

from mirrormount.network.relay import AHEAD, Relay

REST = b"1,2,0|0,0,0,0,1,0|0,0,0,0,1,0\r\n"
MOVES = b"1,2,0|0,1,1,0,0,0|0,0,0,0,1,0\r\n"


class Board:
    """Takes what a relay sends, and answers its questions when the test says so."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.taken = b""
        self.relay = Relay(self._take, lambda: self.now_s)
        self._answered = 0

    def _take(self, data: bytes) -> None:
        self.taken += data

    def sent(self, data: bytes) -> bytes:
        """What the board gets when the client sends data."""
        before = len(self.taken)
        self.relay.from_client(data)
        return self.taken[before:]

    def answers(self, status: bytes = REST) -> bytes:
        """The board answers all questions of the relay; what of it the client sees."""
        lines = self.taken[self._answered :].splitlines()
        self._answered = len(self.taken)
        said = b"".join(
            b"01>" + (status if line.endswith(b"XS?") else b"500\r\n") for line in lines if line.startswith(b"01>")
        )
        return self.relay.from_board(said)

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
    taken = board.sent(b"02550255" * 10_000)
    assert len(taken) <= AHEAD + 32
    assert b"0255" not in board.passes(0.3)
    assert board.answers() == b""
    board.relay.pump()
    assert AHEAD < len(board.taken) <= 2 * AHEAD + 64


@pytest.mark.parametrize("stop", [b"!", b"00000000"])
def test_a_stop_behind_a_flood_goes_at_once_and_voids_what_waits(board, stop):
    board.sent(b"02550255" * 10_000)
    before = len(board.taken)
    assert before <= 1024
    assert board.sent(stop).startswith(b"!\n")
    assert b"0255" not in board.taken[before:]


def test_what_stands_right_before_a_stop_goes_with_it(board):
    assert board.sent(b"1XM60000\n!2DH7\n").startswith(b"1XM60000\n!2DH7\n")


def test_a_board_that_drops_an_answer_is_not_waited_for_for_ever(board):
    board.sent(b"02550255" * 1000)
    before = len(board.taken)
    board.passes(0.6)
    assert len(board.taken) > before


def test_a_message_goes_to_the_board_when_it_is_whole(board):
    assert board.sent(b"1T") == b""
    assert board.sent(b"P?\n2") == b"1TP?\n"
    assert board.sent(b"TP?\r") == b"2TP?\r"
    assert board.sent(b"0255") == b""
    assert board.sent(b"0000").endswith(b"02550000")


def test_a_message_that_is_not_finished_goes_to_the_board_which_refuses_it(board):
    assert board.sent(b"1PR") == b""
    assert board.passes(0.6) == b"1PR"
    assert board.sent(b"025") == b"025"
    board.passes(2)
    assert board.sent(b"0255") == b""
    assert b"0255" in board.passes(0.1)


@pytest.mark.parametrize(
    "motion", [b"1PR5\n", b"1MV+\n", b"02550000", b"2PA7;1TP?\n", b"1XU9000\n", b"1OR\n", b"2MT-\n"]
)
def test_what_starts_a_motion_takes_a_keep_alive_with_it_which_is_fed(board, motion):
    assert board.sent(motion) in (motion + b"XK500\n", b"XK500\n" + motion)
    fed = board.passes(1, answers=MOVES)
    assert 8 <= fed.count(b"01>XS?\n") <= 10
    board.passes(0.2, answers=REST)
    assert board.passes(1) == b""


@pytest.mark.parametrize("line", [b"1TP?\n", b"1PR?\n", b"*IDN?\n", b"1VA5\n", b"00000000", b"ST\n", b"!\n"])
def test_what_starts_no_motion_takes_none(board, line):
    assert board.sent(line) == line
    assert board.passes(1) == b""


def test_a_client_sees_its_own_keep_alive_and_the_board_ends_its_motion_when_it_is_over(board):
    assert board.sent(b"XK5000;1MV+\n") == b"XK5000;1MV+\nXK500\n"
    assert board.sent(b"XK?\n") == b"XK5000\nXK?\nXK500\n"
    fed = board.passes(4.4, answers=MOVES)
    assert fed.count(b"01>XS?\n") > 35
    last = board.passes(0.15, answers=MOVES)
    assert last.count(b"01>XS?\n") == 1  # half a second before the client's time is over, then no more
    assert board.passes(5) == b""
    assert board.sent(b"XK?\n") == b"XK0\nXK?\nXK500\n"


def test_a_keep_alive_that_is_over_is_not_a_clients_any_more(board):
    board.sent(b"XK1000\n")
    board.now_s += 1.01
    assert board.sent(b"XK?\n") == b"XK0\nXK?\nXK500\n"


def test_a_short_keep_alive_of_a_client_is_fed_by_that_client_alone(board):
    assert board.sent(b"XK300;1MV+\n").startswith(b"XK300;1MV+\nXK300\n")
    assert board.passes(0.29, answers=MOVES).count(b"01>") <= 1
    assert board.sent(b"2T").endswith(b"\0")  # half a line feeds it, too
    assert board.passes(3).count(b"01>") <= 1


@pytest.mark.parametrize("pause_s", [0.0, 0.009, 0.05])
@pytest.mark.parametrize("stops", [False, True])
def test_a_frame_behind_a_short_keep_alive_that_may_be_over_has_one(board, pause_s, stops):
    board.sent(b"XK10\n02550000")
    if stops:
        board.relay.stop()
    board.now_s += pause_s
    assert board.sent(b"02550000") in (b"XK10\n02550000", b"XK500\n02550000")


@pytest.mark.parametrize("cut", [0, 3, 8, 9, 10, 12, 15])
@pytest.mark.parametrize("pause_s", [0.0, 0.09, 0.15, 1.0])
def test_nothing_comes_between_a_frame_and_the_bytes_that_show_it_to_be_the_boards_own_reply(board, cut, pause_s):
    board.sent(b"02550000\n")
    board.passes(pause_s, answers=MOVES)
    reply = b"02550000\r\n255\r\n0\r\n255\r\n0\r\n"
    sent = board.sent(reply[:cut]) + board.passes(0.01) + board.sent(reply[cut:])
    assert reply[:13] in sent, sent


def test_what_begins_after_a_silence_in_a_skipped_message_begins_on_the_board_as_well(board):
    board.sent(b"1P!")
    board.now_s += 0.1
    assert board.sent(b"02550000") == b"!\nXK500\n02550000"
    assert board.passes(0.3, answers=MOVES).count(b"01>XS?\n") >= 2


def test_after_a_silence_that_may_have_been_too_short_both_skip(board):
    board.sent(b"1P!")
    board.now_s += 0.04
    assert board.sent(b"02550000") == b"\x7f02550000"
    assert board.sent(b"\n02550000").endswith(b"\nXK500\n02550000")


def test_a_keep_alive_that_the_board_refuses_is_none(board):
    board.sent(b"XK60001\n")
    assert board.relay.client_ms == 0


def test_answers_to_questions_of_the_relay_are_taken_out_and_no_others(board):
    board.sent(b"1MV+\n")
    board.passes(0.15)
    assert board.relay.from_board(b"7\r\n01>" + MOVES + b"1>8\r\n01") == b"7\r\n1>8\r\n"
    assert board.relay.from_board(b"9\r\n") == b"019\r\n"


def test_a_client_that_uses_the_address_of_the_relay_gets_its_answers(board):
    board.sent(b"01>1TP?\n1MV+\n")
    board.passes(0.15)
    assert board.relay.from_board(b"01>7\r\n01>" + MOVES) == b"01>7\r\n"


def test_when_the_client_leaves_moves_of_known_length_go_on_and_runs_end(board):
    board.sent(b"1PR20;2MV+\n")
    before = len(board.taken)
    assert board.relay.client_left()
    assert board.taken[before:] == b"2ST\nXK500\n"
    assert board.passes(1, answers=MOVES).count(b"01>XS?\n") >= 8


def test_a_frame_does_not_end_a_move_of_a_third_axis(board):
    board.sent(b"3PR20\n02550255")
    before = len(board.taken)
    assert board.relay.client_left()
    assert board.taken[before:] == b"1ST\n2ST\nXK500\n"


@pytest.mark.parametrize("sent", [b"1MV+\n", b"02550255", b"1MV+\n1PR5\n", b"1TP?\n", b"", b"1PR5\n02550255", b"1PR"])
def test_when_the_client_leaves_without_such_a_move_all_stops(board, sent):
    board.sent(sent)
    assert not board.relay.client_left()
    assert board.taken.endswith(b"!\n")


@pytest.mark.parametrize("begun", [b"1MV+", b"1PR500", b"0255000"])
def test_what_a_client_that_leaves_has_not_finished_is_not_finished_for_it(board, begun):
    board.sent(b"2PR20\n" + begun)
    board.passes(0.6, answers=MOVES)
    before = len(board.taken)
    assert not board.relay.client_left()
    assert board.taken[before:] == b"!\n"


def test_a_client_that_leaves_behind_a_flood_stops_all(board):
    board.sent(b"1PR20\n" + b"02550255" * 1000)
    assert not board.relay.client_left()
    assert board.taken.endswith(b"!\n")


def test_the_keep_alive_of_a_client_that_left_does_not_end_its_move(board):
    board.sent(b"XK300;1PR20\n")
    assert board.relay.client_left()
    assert board.passes(2, answers=MOVES).count(b"01>XS?\n") >= 18


def test_answers_for_the_client_before_are_not_given_to_the_next_one(board):
    board.sent(b"1PR20;1TP?\n")
    board.relay.client_left()
    board.relay.mute_old_replies()
    assert board.relay.from_board(b"7\r\n") == b""
    board.answers(MOVES)
    assert board.relay.from_board(b"8\r\n") == b"8\r\n"
