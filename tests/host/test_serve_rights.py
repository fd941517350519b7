"""`mirrormount serve`: who may use it, and what is told to who may not."""

import socket

import pytest
from served import run_cli
from serving import RUN, Served, ask, hear, runs

from mirrormount import errors, serve
from mirrormount.device import session
from mirrormount.transport.link import NOT_ALLOWED

# a client's motion lasts while `serve` feeds the board's keep-alive of 0.5 s: on a busy computer it ends, by design

BODY = b"\r\nHost: 127.0.0.1\r\nContent-Length: 14\r\n\r\n" + RUN


@pytest.mark.parametrize(
    "begins",
    [
        b"\x16\x03\x01\x02\x00!\n" + RUN,
        b"PRI * HTTP/2.0" + BODY,
        b"POST / HTTP/1.1" + BODY,
        b"02550000 / HTTP/1.1" + BODY,
    ],
)
def test_a_web_browser_reaches_no_board(served, board, begins):
    serve = served()
    serve.connect(begins)
    serve.says("web browser")
    assert ask(serve.drive(), b"1XM?;1MV?;TB?") == b"10000; 0; 0, NO ERROR DETECTED"
    assert board.edges() == []


def test_a_web_browser_beside_a_client_stops_nothing(served, board):
    serve = served()
    drives = serve.drive(RUN)
    runs(board)
    assert hear(serve.connect(b"POST / HTTP/1.1" + BODY), 1000) == b""
    assert ask(drives, b"1MV?") == b"+"


@pytest.mark.parametrize(
    ("peer", "allowed", "may"),
    [
        ("127.0.0.1", [], True),
        ("::1", [], True),
        ("192.168.1.17", ["192.168.1.17"], True),
        ("192.168.1.18", ["192.168.1.17"], False),
        ("192.168.1.18", ["10.0.0.0/8", "192.168.1.17/24"], True),
        ("::ffff:192.168.1.17", ["192.168.1.0/24"], True),
        ("fe80::1%eth0", ["fe80::/10"], True),
        ("192.168.1.17", ["fe80::/10"], False),
    ],
)
def test_who_may_drive(peer, allowed, may):
    assert serve._is_allowed(peer, serve.networks(allowed)) == may


def test_a_computer_that_may_not_drive_is_told_and_reaches_nothing(served, board, monkeypatch):
    listening = serve.listen("0.0.0.0", 0, serve.networks(["192.0.2.0/24"]))
    monkeypatch.setattr(serve, "_is_allowed", lambda *_: False)
    server = serve.Server(str(board.link), listening, [])
    try:
        with socket.create_connection(listening.getsockname()) as client:
            client.sendall(RUN)
            server.run_once()
            assert hear(client, 1000) == NOT_ALLOWED.encode() + b"\r\n"
    finally:
        server.close()
        listening.close()
    assert board.edges() == []


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--tcp", "0.0.0.0:0"), "--allow"),
        (("--tcp", "[::]:0"), "--allow"),
        (("--tcp", "0", "--host", "0.0.0.0"), "--allow"),
        (("--tcp", "0", "--allow", "192.168.1"), "--allow is an address"),
        (("--tcp", "127.0.0.1:0", "--host", "0.0.0.0"), "once"),
        (("--tcp", "127.0.0.1:70000"), "HOST:PORT"),
        (("--tcp", ":5000"), "HOST:PORT"),
        (("--tcp", "no.such.host.invalid:5000"), "no such host"),
        (("--tcp", "0", "--port", "virtual://?speed=max"), "pace"),
        (("--tcp", "0", "--port", "/dev/does-not-exist"), "no such port"),
    ],
)
def test_what_cannot_be_served_is_one_line(words, says):
    run = run_cli("serve", *words)
    assert run.returncode == 1
    assert run.stderr.startswith("mirrormount: ") and run.stderr.count("\n") == 1 and says in run.stderr


def test_a_mount_that_may_not_drive_says_so():
    with pytest.raises(errors.AllowNeeded, match="ssh"):
        session._check_served(NOT_ALLOWED)


def test_a_wider_network_is_served_to_those_who_are_named(tmp_path):
    served = Served(tmp_path, "virtual://", "--host", "0.0.0.0", "--allow", "192.0.2.1")
    assert served.ready.startswith("ready socket://0.0.0.0:")
    assert ask(served.drive(), b"1MV?") == b"0"
    served.clear_up()


def test_a_port_in_use_is_one_line_with_the_remedy(board):
    run = run_cli("serve", "virtual://", "--tcp", board.tcp.removeprefix("socket://"))
    assert run.returncode == 1
    assert run.stderr.count("\n") == 1 and "another port" in run.stderr


def test_a_client_that_does_not_read_loses_whole_answers():
    ours, theirs = socket.socketpair()
    client = serve.Client(ours)
    answer = b"an answer of a board\r\n"
    while not client.flush():  # what the system buffers
        client.answer(answer)
    for _ in range(10_000):
        client.answer(answer)
    theirs.setblocking(False)
    heard = b""
    while client.flush() or not heard:
        heard += theirs.recv(1 << 20)
    heard += theirs.recv(1 << 20)
    assert set(heard.splitlines(keepends=True)) == {answer}
    ours.close()
    theirs.close()
