"""A page of another port of the same host, in the same browser, and what it can do to the panel: nothing."""

import http.server
import json
import threading
from collections.abc import Iterator
from http.client import HTTPConnection

import pytest
from running import Panel, press, wait_for_motion
from served import wait_for
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

FRAME = """<!doctype html><title>a game</title><script>let loads = 0</script>
<iframe src="{}" style="position:fixed;inset:0;width:100%;height:100%;opacity:0.01" onload="loads++"></iframe>"""

STEPS = 8  # 4 s


@pytest.fixture
def panel_options() -> list[str]:
    return ["--patience", "2"]  # nothing here is about a page that is out of touch


@pytest.fixture
def other_site(panel: Panel) -> Iterator[str]:
    """A site at another port that frames the panel."""
    html = FRAME.format(panel.url).encode()

    class Site(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("content-type", "text/html")
            self.end_headers()
            self.wfile.write(html)

        def log_message(self, *_: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Site)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}/"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def foreign(other_site, context):
    page = context.new_page()
    page.set_viewport_size({"width": 1600, "height": 1000})
    page.goto(other_site)
    page.wait_for_function("loads > 0")
    yield page
    page.close()


def test_a_site_that_frames_the_panel_cannot_have_a_press_steer_it(open_page, foreign, panel, board):
    assert "data-press" not in foreign.frames[-1].content()
    for x, y in ((210, 140), (210, 320), (100, 230), (320, 230)):  # where the pad is
        foreign.mouse.click(x, y)
    page = open_page(panel.url)
    press(page.get_by_role("button", name="UP", exact=True))  # no page was there before: this one controls
    wait_for_motion(board)
    assert {e["pin"] for e in board.edges()} == {"m1_pos", "m1_en"}


def test_a_site_can_open_no_socket_and_read_no_page(foreign, panel):
    assert (
        foreign.evaluate(
            """(url) => new Promise((done) => {
                const socket = new WebSocket(url);
                socket.onopen = () => done("open");
                socket.onclose = () => done("closed");
            })""",
            f"ws://127.0.0.1:{panel.port}/drive",
        )
        == "closed"
    )
    read = "(url) => fetch(url).then(() => 'read', () => 'refused')"
    assert foreign.evaluate(read, panel.url) == "refused"
    image = "(url) => new Promise((done) => { const i = new Image(); i.onload = i.onerror = done; i.src = url; })"
    foreign.evaluate(f"(url) => ({image})(url).then(() => 0)", panel.url)


def page_key(panel: Panel) -> str | None:
    """The secret of a page that is fetched now, None if there was none to be had."""
    connection = HTTPConnection("127.0.0.1", panel.port)
    connection.request("GET", "/")
    answer = connection.getresponse()
    html = answer.read().decode()
    connection.close()
    return html.partition('"data-page":"')[2].partition('"')[0] if answer.status == 200 else None


@pytest.mark.full
def test_pages_that_are_fetched_in_a_row_do_not_end_what_the_controlling_page_drives(page, panel, board):
    start_steps(page, board)
    keys = [page_key(panel) for _ in range(30)]
    assert keys[0] is not None  # how many are refused: test_sign_in.py
    wait_for_steps(board)


def start_steps(page, board) -> None:
    page.get_by_label("Number of steps").fill(str(STEPS))
    press(page.get_by_text("right ▶"))
    wait_for_motion(board)


def wait_for_steps(board) -> None:
    """Wait until all are made, each to its end."""

    def made() -> bool:
        edges = [e for e in board.edges() if e["pin"] == "m2_en"]
        on_us = [off["t_us"] - on["t_us"] for on, off in zip(edges[::2], edges[1::2], strict=False)]
        return sum(us > 199_000 for us in on_us) == STEPS

    wait_for(made, "all steps")


@pytest.mark.full
def test_a_socket_that_sends_too_much_is_closed_and_the_page_that_drives_goes_on(page, panel, board):
    with connect(f"ws://127.0.0.1:{panel.port}/drive", proxy=None, ping_interval=None) as flood:
        flood.send(json.dumps({"page": page_key(panel)}))
        start_steps(page, board)
        with pytest.raises(ConnectionClosed):
            send_many(flood)
        assert flood.close_code == 4429
    wait_for_steps(board)


def send_many(socket) -> None:
    for _ in range(20_000):
        socket.send('{"do": "beat", "tick": 1}')
    socket.recv()


@pytest.mark.full
def test_whoever_watches_by_a_bare_socket_can_stop(page, panel, board):
    with connect(f"ws://127.0.0.1:{panel.port}/drive", proxy=None, ping_interval=None) as watcher:
        watcher.send(json.dumps({"page": page_key(panel)}))
        start_steps(page, board)
        watcher.send('{"do": "stop"}')
        page.get_by_text("last move: aborted").wait_for()


@pytest.mark.full
def test_a_page_cannot_write_to_the_panels_terminal_or_log(page, panel, tmp_path):
    for level in ("error", "warning"):
        page.evaluate(
            "(level) => window.socket.emit('log', { client_id: window.clientId, level, message: '\\x1b[31mred' })",
            level,
        )
    page.get_by_text("What goes over the wire").click()  # by the same connection, so after it
    page.get_by_text("with the questions after the state").wait_for()
    assert "red" not in panel.end()
    assert "red" not in "".join(log.read_text() for log in tmp_path.rglob("panel.log*"))
