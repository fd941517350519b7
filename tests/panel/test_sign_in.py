"""Codes, tokens and rates, with a clock that the test turns; and what is written to the log."""

import asyncio
import logging
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from supervised import Clock

from mirrormount_panel import auth
from mirrormount_panel.auth import CODE_S, Auth, Rate, Rates, SignIn
from mirrormount_panel.server import _Printable

TOKEN = b"kKq3-0d7LbX_u2mTzR9sWg"


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def sign_in(clock):
    return SignIn(TOKEN, clock)


def test_the_token_signs_in_as_often_as_it_is_posted(sign_in):
    assert [sign_in.judge("10.0.0.1", TOKEN).key for _ in range(3)] == [sign_in.key] * 3


def test_a_code_signs_in_once(sign_in):
    code = sign_in.new_code().encode()
    assert sign_in.judge("10.0.0.1", code).key == sign_in.key
    assert sign_in.judge("10.0.0.1", code).key is None


def test_a_code_that_a_page_has_shown_is_valid_for_ten_minutes(sign_in, clock):
    codes = [sign_in.new_code().encode() for _ in range(2)]
    clock.now_s += CODE_S - 1
    assert sign_in.judge("10.0.0.1", codes[0]).key == sign_in.key
    clock.now_s += 2
    assert sign_in.judge("10.0.0.1", codes[1]).key is None


def test_the_code_of_the_terminal_waits_for_its_user_and_is_replaced_when_it_was_used(sign_in, clock):
    told = []
    sign_in.told = lambda client, code: told.append((client, code))
    code = sign_in.terminal_code()
    clock.now_s += 100 * CODE_S
    for _ in range(100):
        sign_in.new_code()
    assert sign_in.judge("10.0.0.1", code.encode()).key == sign_in.key
    assert told == [("10.0.0.1", sign_in.terminal_code())]
    assert sign_in.terminal_code() != code


def test_codes_that_nobody_uses_do_not_fill_the_memory(sign_in):
    codes = [sign_in.new_code().encode() for _ in range(100)]
    assert sign_in.judge("10.0.0.1", codes[0]).key is None
    assert sign_in.judge("10.0.0.1", codes[-1]).key == sign_in.key


@pytest.mark.parametrize("secret", [b"", b"x", TOKEN[:-1], TOKEN + b"x", b"\xff\x00", b"x" * 513])
def test_what_is_neither_a_code_nor_the_token_is_refused(sign_in, secret):
    answer = sign_in.judge("10.0.0.1", secret)
    assert answer.status == 403 and answer.key is None and sign_in.key not in answer.text


def test_neither_the_cookie_nor_its_name_nor_the_key_give_the_others_away(sign_in):
    cookie, name, key = sign_in.cookie.decode(), sign_in.cookie_name, sign_in.key
    assert len({cookie, key}) == 2 and name[-8:] not in cookie + key
    assert SignIn(b"other").key != key


def test_a_rate_lets_so_many_through_at_once_and_then_so_many_a_second(clock):
    rate = Rate(5, 2, clock)
    assert [rate.take() for _ in range(7)] == [True] * 5 + [False] * 2
    clock.now_s += 1
    assert [rate.take() for _ in range(3)] == [True, True, False]
    clock.now_s += 1000
    assert [rate.take() for _ in range(6)] == [True] * 5 + [False]


def test_each_client_has_a_rate_of_its_own_and_clients_do_not_fill_the_memory():
    rates = Rates(1, 0.001, clients=10)
    assert [rates.of(client).take() for client in "aab"] == [True, False, True]
    for n in range(1000):
        rates.of(str(n))
    assert len(rates._rates) == 10


def test_nothing_in_the_log_controls_a_terminal():
    record = logging.LogRecord("x", logging.ERROR, "", 0, "bell \x07 and \x1b[31m red\nsecond", None, None)
    assert _Printable("%(message)s").format(record) == "bell \\x07 and \\x1b[31m red\nsecond"


async def app(_scope, _receive, send) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"<script>1</script>"})


@pytest.fixture(autouse=True)
def waits(monkeypatch):
    """How long the panel has let requests wait, which they do not here."""
    waited, sleep = [], asyncio.sleep
    monkeypatch.setattr(auth.asyncio, "sleep", lambda wait_s: (waited.append(wait_s), sleep(0))[1])
    return waited


def statuses(paths: list[str], method: str = "GET") -> list[int]:
    """What a panel without a token answers to one client's requests, all in one turn of its clock."""
    answers = []

    async def send(message) -> None:
        if message["type"] == "http.response.start":
            answers.append(message["status"])

    async def ask() -> None:
        panel = Auth(app, SignIn(None), Clock())
        for path in paths:
            scope = {"type": "http", "method": method, "path": path, "query_string": b"", "client": ("127.0.0.1", 1)}
            await panel({**scope, "headers": [(b"host", b"localhost")]}, None, send)

    run(ask())
    return answers


def run(work: Coroutine[Any, Any, None]) -> None:
    with ThreadPoolExecutor(1) as pool:  # the browser of other tests has a loop in this thread
        pool.submit(lambda: asyncio.run(work)).result()


def test_so_many_pages_are_made_for_a_client_with_all_their_files():
    assert statuses(["/"] * 7) == [200] * 6 + [429]
    assert statuses(["/panel/panel.js"] * 100) == [200] * 100


@pytest.mark.parametrize("path", ["/panel/panel.js", "/camera/9", "/hold/state", "/enter", "/no/such/page", "/stop"])
def test_beyond_a_rate_a_client_waits_and_is_then_refused_but_for_a_stop(path, waits):
    answers = statuses([path] * 227)
    assert answers[225:] == [429] * 2 and 429 not in answers[:225]
    assert waits == pytest.approx([n / 100 for n in range(1, 201)] + [2.0] * 2)
    waits.clear()
    assert statuses(["/stop"] * 1000, "POST") == [200] * 1000
    assert not waits


def test_a_crowd_of_sockets_does_not_take_all_files_of_the_panel():
    said = []

    async def hold(_scope, _receive, _send) -> None:
        await asyncio.Event().wait()

    async def connect() -> dict[str, str]:
        return {"type": "websocket.connect"}

    async def send(message) -> None:
        said.append(message)

    async def ask() -> None:
        panel = Auth(hold, SignIn(None), Clock())
        scope = {
            "type": "websocket",
            "path": "/drive",
            "client": ("127.0.0.1", 1),
            "headers": [(b"host", b"localhost")],
        }
        crowd = [asyncio.create_task(panel(scope, connect, send)) for _ in range(100)]
        await asyncio.sleep(0)
        assert not said
        await panel(scope, connect, send)
        assert said == [{"type": "websocket.close", "code": 4403}]
        crowd.pop().cancel()
        await asyncio.sleep(0)
        crowd.append(asyncio.create_task(panel(scope, connect, send)))
        await asyncio.sleep(0)
        assert len(said) == 1
        for one in crowd:
            one.cancel()

    run(ask())
