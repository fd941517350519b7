"""What is taken out of a network client's bytes, who is let in, and what a client that does not read loses."""

import socket

import pytest
from served import PATIENCE_S, wait_for

from mirrormount.common import errors
from mirrormount.common.tokens import Guesses
from mirrormount.network import listener
from mirrormount.network.client_session import ClientSession
from mirrormount.network.listener import Listener
from mirrormount.transport.telnet import Inlet


@pytest.mark.parametrize(
    ("sent", "for_the_board"),
    [
        (b"1PR5\r\n", b"1PR5\r\n"),
        (b"\xff\xfb\x01\xff\xfe\x031TP?\n", b"1TP?\n"),
        (b"1P\xff\xfd\x01R5\n", b"1PR5\n"),
        (b"\xff\xff1TP?\n", b"1TP?\n"),
        (b"\xff\xf11TP?\n", b"1TP?\n"),
        (b"\xff\xfa\x18\x00XTERM\xff\xff-1MV+\xff\xf01TP?\n", b"1TP?\n"),
        (b"\xff\xf4\xff\xfd\x06", b"!"),
        (b"\xff\xf3", b"!"),
        (b"\xff!\n", b"!\n"),
        (b"\xff\xfa!\n", b"!\n"),
        (b"\xff\xfa\x18\xff!\n", b"!\n"),
        (b"\xff\xfa" + b"x" * 64 + b"1TP?\n", b"!1TP?\n"),
        (b"\xff\xfa\x18" + b"0" * 8 + b"1TP?\n", b"!1TP?\n"),
        (b"\xff\xfd!\n", b"!\n"),
        (b"\xff\xfb00000000", b"00000000"),
        (b"\x7f\x80\xfe", b"\x7f\x80\xfe"),
        (b"\x03\x01\x02\x04\x05\x181TP?\n", b"!1TP?\n"),
    ],
)
def test_telnets_bytes_are_taken_out_and_a_stop_never_is(sent, for_the_board):
    assert Inlet(True).feed(sent) == for_the_board
    one_by_one = Inlet(True)
    assert b"".join(one_by_one.feed(bytes((c,))) for c in sent) == for_the_board


@pytest.mark.parametrize("begun", [b"\xff", b"\xff\xfd", b"\xff\xfa", b"\xff\xfa\x18\x00", b"\xff\xfa\x18\xff"])
def test_a_negotiation_that_stands_still_takes_nothing_more(begun):
    now = [0.0]
    inlet = Inlet(True, lambda: now[0])
    assert inlet.feed(begun) == b""
    now[0] += 1.1
    assert inlet.feed(b"1TP?\n") == b"1TP?\n"


@pytest.mark.parametrize("begun", [b"\xff", b"\xff\xfd", b"\xff\xfa", b"\xff\xfa\x18\x00", b"\xff\xfa\x18\xff"])
def test_a_stop_in_an_unfinished_negotiation_is_passed_on_with_the_byte_that_completes_it(begun):
    for stop in (b"!", b"00000000"):
        inlet = Inlet(True)
        inlet.feed(begun)
        passed = [inlet.feed(bytes((c,))) for c in stop]
        assert passed[-1] and b"".join(passed) in (b"!", stop)


def test_without_telnet_only_the_keys_of_the_boards_prompt_are_kept_back():
    every = bytes(range(256))
    passed = every.replace(b"\x03", b"!").translate(None, b"\x01\x02\x04\x05\x18")
    assert Inlet(False).feed(every) == passed


@pytest.fixture
def at_door():
    here = Listener("127.0.0.1", 0, b"secret", telnet=True)
    clients: list[socket.socket] = []

    def come() -> socket.socket:
        clients.append(socket.create_connection(("127.0.0.1", int(here.address.rsplit(":", 1)[1])), PATIENCE_S))
        return clients[-1]

    yield here, come
    here.close()
    for client in clients:
        client.close()


def test_a_token_that_comes_too_late_is_not_taken(at_door, monkeypatch):
    here, come = at_door
    client = come()
    wait_for(lambda: here.poll() or here.busy(), "the client to be seen")
    monkeypatch.setattr(listener, "TOKEN_S", 0.0)
    here.poll()
    assert client.recv(100) == b"mirrormount: the first line must be the token\r\n"
    client.sendall(b"secret\n")
    assert client.recv(100) == b""
    assert here.next() is None


def test_what_follows_the_token_is_kept_for_the_board(at_door):
    here, come = at_door
    client = come()
    for part in (b"\xff\xfd\x03sec", b"ret\r\n1TP?\n"):
        client.sendall(part)
        here.poll()
    session = wait_for(lambda: here.poll() or here.next(), "the client to be let in")
    assert session.pending == b"1TP?\n"
    session.socket.close()


def test_a_crowd_without_a_token_does_not_keep_out_the_one_who_has_it(at_door):
    here, come = at_door
    for _ in range(40):
        come()
        here.poll()
    come().sendall(b"secret\n")
    session = wait_for(lambda: here.poll() or here.next(), "the client to be let in")
    session.socket.close()


def test_silent_newcomers_do_not_close_the_connection_of_a_slow_one_who_types_the_token(at_door):
    here, come = at_door
    slow = come()
    slow.sendall(b"sec")
    wait_for(lambda: here.poll() or any(session.pending for session in here._unauthenticated), "the first letters")
    for _ in range(listener._NEWCOMERS_MOST + 8):
        come()
        here.poll()
    slow.sendall(b"ret\n")
    session = wait_for(lambda: here.poll() or here.next(), "the client to be let in")
    session.socket.close()


def test_who_opens_many_connections_closes_his_own():
    crowd = []
    for n in range(5):
        crowd.append(ClientSession(socket.socket(), f"many:{n}", Inlet(True)))
        crowd[-1].address = "192.0.2.1"
    silent = ClientSession(socket.socket(), "one", Inlet(True))
    silent.address, silent.since_s = "192.0.2.2", 0.0
    assert listener._least_proven([silent, *crowd]) is crowd[0]
    for session in [silent, *crowd]:
        session.socket.close()


def test_guesses_are_slowed_down_and_the_right_one_waits_too(at_door):
    here, come = at_door
    now = [0.0]
    here._guesses = Guesses(lambda: now[0])
    for n in range(5):
        guess = come()
        guess.sendall(b"guess %d\n" % n)
        wait_for(lambda: here.poll() or here._rejected, "the guess to be compared")
        guess.close()
        wait_for(lambda: here.poll() or not here._rejected, "it to leave")
    client = come()
    client.sendall(b"secret\n")
    wait_for(lambda: here.poll() or any(session.pending for session in here._unauthenticated), "the token")
    here.poll()
    assert here.next() is None
    now[0] += 1.1
    session = wait_for(lambda: here.poll() or here.next(), "the client to be let in")
    session.socket.close()


def test_a_port_that_this_user_may_not_use_is_an_error_with_the_remedy(monkeypatch):
    def refuse(*_args, **_kw):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(socket, "create_server", refuse)
    with pytest.raises(errors.CannotListen, match=r"below 1024.*another port"):
        Listener("127.0.0.1", 23, None, telnet=True)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.0.2.1"])
def test_more_than_this_computer_needs_a_token(host):
    with pytest.raises(errors.TokenNeeded, match="--token"):
        Listener(host, 0, None, telnet=True)


def test_answers_that_nobody_takes_are_dropped_in_whole_lines():
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.setblocking(False)
        session = ClientSession(ours, "a client", Inlet(True))
        assert [session.answer(b"12345\r\n" * 10_000) for _ in range(3)] == [True, False, False]
        assert not session.answer(b"1")
        assert not session.answer(b"7\r\n2")
        session.flush()
        assert theirs.recv(100) == b"17\r\n"
