"""`mirrormount serve`: who may use it, and what is told to who may not."""

import pytest
from served import run_cli
from serving import GREETING, RUN, Served, ask, hear, hear_line, runs

from mirrormount import Mount
from mirrormount.common import errors

# a client's motion lasts while `serve` feeds the board's keep-alive of 0.5 s: on a busy computer it ends, by design


@pytest.mark.parametrize("begins", [b"\x16\x03\x01\x02\x00!\n1MV+\n", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n1MV+\n"])
def test_tls_and_http2_reach_no_board(served, board, begins):
    serve = served("--no-telnet")
    serve.connect(begins)
    serve.says("motors stopped")
    assert ask(serve.connect(), b"1MV?;TB?") == b"0; 0, NO ERROR DETECTED"
    assert board.edges() == []


def test_a_short_token_is_told_and_one_from_a_file_is_taken(served, tmp_path):
    (tmp_path / "token").write_text("token-of-the-test\n")
    serve = served("--token-file", str(tmp_path / "token"))
    assert "the token can be guessed" in serve.log.read_text()
    client = serve.connect(b"token-of-the-test\n1TP?\n")
    assert hear(client, 6) == GREETING and hear_line(client) == b"0\r\n"


@pytest.mark.parametrize("first", [b"token-of-the-test\n", b"token-of-the-test\r\n"])
def test_with_the_right_token_a_client_is_greeted_and_served(served, first):
    client = served("--token", "token-of-the-test").connect(first + b"1TP?\n")
    assert hear(client, 6) == GREETING
    assert hear_line(client) == b"0\r\n"


@pytest.mark.parametrize("first", [b"wrong\n", RUN, b"token-of-the-tes\n", b"\n", b"x" * 300])
def test_without_the_right_token_nothing_reaches_the_board_and_no_client_is_stopped(served, board, first):
    serve = served(MIRRORMOUNT_TOKEN="token-of-the-test")
    controls = serve.connect(b"token-of-the-test\n2XM60000;2MV+\n")
    runs(board)
    assert hear(serve.connect(first), 1000) == b"mirrormount: the first line must be the token\r\n"
    hear(controls, 6)
    assert ask(controls, b"1MV?;2MV?;TB?") == b"0; +; 0, NO ERROR DETECTED"


def test_a_mount_that_meets_a_token_says_so(served):
    with pytest.raises(errors.TokenNeeded, match="ssh"):
        Mount.open(served("--token", "token-of-the-test").tcp)


def test_a_browser_that_posts_commands_is_not_obeyed(served, board):
    body = b"1XM60000;1MV+\n"
    serve = served("--no-telnet")
    serve.connect(b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 14\r\n\r\n" + body)
    serve.says("web browser")
    assert ask(serve.connect(), b"1XM?;1MV?") == b"10000; 0"
    assert board.edges() == []


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--tcp", "0.0.0.0:0"), "--token"),
        (("--tcp", "[::]:0"), "--token"),
        (("--tcp", "127.0.0.1:70000"), "HOST:PORT"),
        (("--tcp", ":5000"), "HOST:PORT"),
        (("--tcp", "no.such.host.invalid:5000"), "no such host"),
        (("--tcp", "127.0.0.1:0", "--token", ""), "printable"),
        (("--tcp", "127.0.0.1:0", "--token", "two\nlines"), "printable"),
        (("--tcp", "127.0.0.1:0", "--port", "virtual://?speed=max"), "pace"),
        (("--tcp", "127.0.0.1:0", "--port", "/dev/does-not-exist"), "no such port"),
    ],
)
def test_what_cannot_be_served_is_one_line(words, says):
    run = run_cli("serve", *words)
    assert run.returncode == 1
    assert run.stderr.startswith("mirrormount: ") and run.stderr.count("\n") == 1 and says in run.stderr


def test_a_wider_network_with_a_token_is_served(tmp_path):
    served = Served(tmp_path, "virtual://", "--tcp", "0.0.0.0:0", "--token", "token-of-the-test")
    assert served.ready.startswith("ready socket://0.0.0.0:")
    served.clear_up()


def test_a_port_in_use_is_one_line_with_the_remedy(board):
    run = run_cli("serve", "virtual://", "--tcp", board.tcp.removeprefix("socket://"))
    assert run.returncode == 1
    assert run.stderr.count("\n") == 1 and "another port" in run.stderr
