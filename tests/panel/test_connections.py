"""A crowd of connections that never finish a request keeps nobody out; a panel that nobody reaches drives nothing."""

import json
import socket
import sys
import threading
from collections.abc import Iterator
from http.client import HTTPConnection

import pytest
import uvicorn
from running import Panel, run_until_driving, status_after
from served import PATIENCE_S, wait_for
from websockets.sync.client import ClientConnection, connect

from mirrormount_panel import connections
from mountfw.codes import ABORTED

CROWD = 230  # more than the panel keeps
HALF = b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\nhalf"  # a body that never ends


def crowd_of(port: int, number: int, sent: bytes) -> list[socket.socket]:
    crowd = [socket.create_connection(("127.0.0.1", port), PATIENCE_S) for _ in range(number)]
    for one in crowd:
        one.sendall(sent)
    return crowd


def is_closed(one: socket.socket) -> bool:
    """Waits until the server has closed it."""
    try:
        while one.recv(4096):
            pass
    except ConnectionResetError:
        pass
    return True


@pytest.mark.parametrize("sent", [b"", HALF])
def test_a_stop_gets_in_whoever_crowds_and_the_oldest_connections_are_let_go(panel: Panel, sent):
    crowd = crowd_of(panel.port, CROWD, sent)
    stop = HTTPConnection("127.0.0.1", panel.port, timeout=PATIENCE_S)
    stop.request("POST", "/stop")
    assert stop.getresponse().status == 204
    assert is_closed(crowd[0])
    for one in [*crowd, stop]:
        one.close()


@pytest.mark.skipif(sys.platform != "linux", reason="Linux limits another process")
def test_a_panel_without_a_file_for_a_stop_ends_what_a_page_moves(panel: Panel, board):
    import resource

    asking = HTTPConnection("127.0.0.1", panel.port, timeout=PATIENCE_S)
    asking.request("GET", "/")
    key = asking.getresponse().read().decode().partition('"data-page":"')[2].partition('"')[0]
    with connect(f"ws://127.0.0.1:{panel.port}/drive", proxy=None, ping_interval=None) as page:
        page.send(json.dumps({"page": key}))
        returned(page, "drive", x=200, y=0)
        alive = threading.Event()
        beats = threading.Thread(target=lambda: [returned(page, "beat") for _ in iter(alive.is_set, True)])
        beats.start()
        run_until_driving(board)
        most = resource.prlimit(panel.process.pid, resource.RLIMIT_NOFILE)[1]
        resource.prlimit(panel.process.pid, resource.RLIMIT_NOFILE, (3, most))
        wait_for(lambda: not board.driving(), "the motors to rest")
        alive.set()
        beats.join()
    asking.close()
    resource.prlimit(panel.process.pid, resource.RLIMIT_NOFILE, (most, most))
    assert status_after(panel, board).x.reason == ABORTED


def returned(page: ClientConnection, what: str, **more: int) -> None:
    """A message with the next tick."""
    page.send(json.dumps({"do": what, "tick": json.loads(page.recv(PATIENCE_S))["tick"], **more}))


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Of a server that gives a request little time, and whose application reads the body."""
    monkeypatch.setattr(connections, "_REQUEST_S", 0.2)

    async def app(scope, receive, send) -> None:
        while (await receive()).get("more_body"):
            pass
        await send({"type": "http.response.start", "status": 204, "headers": []})
        await send({"type": "http.response.body"})

    config = uvicorn.Config(app, http=connections.BoundedConnection, lifespan="off", log_config=None)
    server = uvicorn.Server(config)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=server.run, args=([listening],))
        thread.start()
        wait_for(lambda: server.started, "the server")
        yield listening.getsockname()[1]
        server.should_exit = True
        thread.join()


@pytest.mark.parametrize("sent", [b"", b"GET / HT", HALF, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET /"])
def test_a_connection_that_does_not_finish_its_request_is_closed(port, sent):
    with crowd_of(port, 1, sent)[0] as one:
        assert is_closed(one)


@pytest.mark.parametrize("path", ["/camera/3", "/hold/state", "/_nicegui/nothing.js"])
def test_no_page_is_built_for_an_address_that_the_panel_lacks(panel: Panel, path):
    asking = HTTPConnection("127.0.0.1", panel.port, timeout=PATIENCE_S)
    asking.request("GET", path)
    answer = asking.getresponse()
    assert (answer.status, answer.read()) == (404, b"The panel has no such page.")
    asking.close()
