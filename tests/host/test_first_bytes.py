"""Who begins as a web browser or TLS does is known before a byte is passed on; no board's client is taken for one."""

import pytest

from mirrormount.transport.first_bytes import FirstBytes, NotAClient

REQUESTS = (
    b"GET / HTTP/1.1\r\n",
    b"POST / HTTP/1.1\r\n",
    b"POST /1MV+ HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n1XM60000;1MV+\n",
    b"OPTIONS * HTTP/1.1\r\n",
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    b"HEAD http://127.0.0.1/ HTTP/1.1\r\n",
    b"CONNECT 127.0.0.1:5023 HTTP/1.1\r\n",
    b"BREW x HTTP/1.1\r\n",
    b"patch / HTTP/1.1\r\n",
    b"MV /1 HTTP/1.0\r\n",
    b"GET x" + b"y" * 200,
)
CHOSEN = (b"1MV+", b"P1", b"M-X", b"0255-100", b"+255+255", b"*RST", b"1234567890")  # methods: a page may choose them


@pytest.mark.parametrize("request_", REQUESTS)
def test_not_one_byte_of_a_request_is_passed_on_however_it_is_cut(request_):
    for size in (1, 2, 5, 1000):
        first = FirstBytes()
        pieces = [request_[at : at + size] for at in range(0, len(request_), size)]
        passed: list[bytes] = []
        with pytest.raises(NotAClient, match="browser"):
            passed.extend(first.feed(piece) for piece in pieces)
        assert b"".join(passed) == b""


@pytest.mark.parametrize("method", CHOSEN)
@pytest.mark.parametrize("target", [b"/", b"/x?y", b"http://a/", b"*", b"x"])
def test_a_method_that_begins_as_a_command_does_is_a_request_all_the_same(method, target):
    request = method + b" " + target + b" HTTP/1.1\r\nHost: a\r\n\r\n1MV+\n"
    with pytest.raises(NotAClient, match="browser"):
        FirstBytes().feed(request)
    first, passed = FirstBytes(), bytearray()
    with pytest.raises(NotAClient, match="browser"):
        passed.extend(c for byte in request for c in first.feed(bytes((byte,))))
    assert b"\n" not in passed


def test_not_one_byte_of_tls_is_passed_on():
    with pytest.raises(NotAClient, match="TLS"):
        FirstBytes().feed(b"\x16\x03\x01\x02\x00!\n1MV+\n")


@pytest.mark.parametrize(
    "sent",
    [
        b"*IDN?\n",
        b"1XM60000;1MV+\n",
        b"02550255\n",
        b"XK500;1MV+\n",
        b"PR 5\n",
        b"VE?\r\n1PR5\r\n",
        b"AB\n",
        b"HOSTNAME mount\n",
        b"ST ; MD?\n",
        b"\xff\xfd\x01\xff\xfd\x03VE?\n",
        b"\n",
        b"31>VE?\n",
        b"XK 500\r",
        b"AB \r",
        b"1PR 5 ; 2PR 5\n",
        b"0255-100+100-255" * 20,
    ],
)
def test_what_a_boards_client_sends_is_passed_on_whole(sent):
    for size in (1, 3, 1000):
        first = FirstBytes()
        assert b"".join(first.feed(sent[at : at + size]) for at in range(0, len(sent), size)) == sent
        assert first.feed(b"\nGET / HTTP/1.1\r\n") == b"\nGET / HTTP/1.1\r\n"


@pytest.mark.parametrize("stop", [b"!", b"\x03", b"00000000"])
def test_a_stop_in_a_line_that_is_not_decided_is_passed_on_at_once(stop):
    first = FirstBytes()
    assert first.feed(b"PR ") == b""
    assert b"".join(first.feed(bytes((c,))) for c in stop) == b"!"
    assert first.feed(b"5") == b""
    assert first.feed(b"\n") == b"PR " + stop + b"5\n"
