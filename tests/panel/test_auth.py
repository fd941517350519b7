"""Who may come in to the panel."""

import http.client
import json
import re
import sys

import pytest
from running import Panel, press, wait_for_motion
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from mirrormount_panel.cli import page_to

FRESH = {"viewport": {"width": 1600, "height": 1000}}  # a browser of its own, without the cookies of other tests


@pytest.fixture
def panel_options() -> list[str]:
    return ["--patience", "2"]  # nothing here is about a page that is out of touch


@pytest.fixture
def wide(board, tmp_path, panel_options):
    panel = Panel(str(board.link), tmp_path, "--host", "0.0.0.0", *panel_options)
    yield panel
    panel.kill()


def status_of(port: int, path: str = "/", **headers: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port)
    connection.request("POST" if path == "/stop" else "GET", path, headers=headers)
    status = connection.getresponse().status
    connection.close()
    return status


def refused(port: int, **headers: str) -> bool:
    """Is a driving socket with these headers refused before it is open?"""
    try:
        with connect(f"ws://127.0.0.1:{port}/drive", additional_headers=headers, proxy=None):
            return False
    except InvalidStatus as e:
        return e.response.status_code == 403


def close_code(port: int, first: object, **headers: str) -> int:
    """The code with which a driving socket is closed after its first message."""
    with connect(f"ws://127.0.0.1:{port}/drive", additional_headers=headers, proxy=None) as socket:
        socket.send(json.dumps(first))
        with pytest.raises(ConnectionClosed):
            socket.recv()
        return socket.close_code


def signed_in(port: int, secret: str, **headers: str) -> tuple[int, str, str]:
    """What posting a code or a token gives: status, cookie, key."""
    connection = http.client.HTTPConnection("127.0.0.1", port)
    connection.request("POST", "/enter", secret, headers)
    answer = connection.getresponse()
    cookie = (answer.headers["set-cookie"] or "").partition(";")[0]
    text = answer.read().decode()
    connection.close()
    return answer.status, cookie, text


def code_of(panel: Panel) -> str:
    return panel.url.partition("#")[2]


def test_a_wider_network_makes_a_one_time_code_and_prints_the_link(wide):
    assert re.fullmatch(r"http://[0-9.]+:\d+/enter#[\w-]{22}", wide.url)
    assert any("whoever has this link can drive" in line for line in wide.said)


def test_the_link_opens_the_panel_once_and_leaves_the_address_bar_clean(open_page, wide, board):
    page = open_page(wide.url, **FRESH)
    page.wait_for_url(wide.url.partition("enter")[0])
    press(page.get_by_role("button", name="UP", exact=True))
    page.get_by_text("+1.000").wait_for()
    again = next(line for line in iter(wide.process.stdout.readline, "") if not line.startswith("ready "))
    assert "the link was used by" in again
    assert code_of(wide) not in again
    assert signed_in(wide.port, code_of(wide))[0] == 403
    assert signed_in(wide.port, again.strip().partition("#")[2])[0] == 200


@pytest.mark.full
def test_the_page_that_hides_the_link_from_other_users_leads_the_browser_there(open_page, wide):
    with page_to(wide.url) as address:
        page = open_page(address, **FRESH)
        page.wait_for_url(wide.url.partition("enter")[0])


@pytest.mark.full
def test_the_address_bar_is_clean_when_the_cookie_is_there_already_too(open_page, wide):
    page = open_page(wide.url, **FRESH)
    address = wide.url.partition("enter")[0]
    page.wait_for_url(address)
    for link in (wide.url, f"{address}?token=abc"):
        page.goto("about:blank")
        page.goto(link)
        page.wait_for_function("location.hash === '' && location.search === ''")
        assert "token" not in page.url and "#" not in page.url
        assert page.evaluate("history.state") is None or "token" not in str(page.evaluate("history.state"))


@pytest.mark.full
def test_the_token_can_be_typed(open_page, board, tmp_path):
    (tmp_path / "token").write_text("kKq3-0d7LbX_u2mTzR9sWg\n")
    panel = Panel(str(board.link), tmp_path, "--host", "0.0.0.0", "--token-file", str(tmp_path / "token"))
    try:
        page = open_page(f"http://127.0.0.1:{panel.port}/", until="form", **FRESH)
        page.get_by_label("Token").fill("wrong")
        page.get_by_role("button", name="Enter").click()
        page.get_by_text("used already, or the token is wrong").wait_for()
        page.get_by_label("Token").fill("kKq3-0d7LbX_u2mTzR9sWg")
        page.get_by_role("button", name="Enter").click()
        page.wait_for_selector("body.steady")
    finally:
        panel.kill()


@pytest.mark.parametrize("link", ["/", "/?token=", "/?token=wrong", "/?token=%ff%00", "/stop", "/panel/panel.js"])
def test_without_a_sign_in_nothing_is_shown(wide, link):
    assert status_of(wide.port, link) == 403


def test_without_a_sign_in_the_driving_socket_is_refused(wide):
    assert refused(wide.port)
    assert refused(wide.port, Cookie="mirrormount_panel=wrong")


def test_the_cookie_alone_drives_nothing(wide):
    """Another port of the same host gets the cookie. It does not get the key, nor, by the page, a link for others."""
    _, cookie, key = signed_in(wide.port, code_of(wide))
    page = page_key(wide.port, cookie)
    headers = {"Cookie": cookie, "Origin": f"http://127.0.0.1:{wide.port}"}
    for first in ({"page": page}, {"page": page, "key": None}, {"page": page, "key": "0" * 64}, [], {"key": "\ud800"}):
        assert close_code(wide.port, first, **headers) == 4401
    assert close_code(wide.port, {"page": "x", "key": key}, **headers) == 4404
    with connect(f"ws://127.0.0.1:{wide.port}/drive", additional_headers=headers, proxy=None) as socket:
        socket.send(json.dumps({"page": page, "key": key}))
        assert "tick" in json.loads(socket.recv(10))


def page_key(port: int, cookie: str) -> str:
    """The secret in the HTML of a page."""
    connection = http.client.HTTPConnection("127.0.0.1", port)
    connection.request("GET", "/", headers={"Cookie": cookie})
    html = connection.getresponse().read().decode()
    connection.close()
    return re.search(r'"data-page":"([\w-]{22})"', html).group(1)


def test_wrong_tokens_are_slowed_down_and_the_right_one_waits_too(wide):
    assert [signed_in(wide.port, f"wrong {i}")[0] for i in range(5)] == [403] * 5
    assert signed_in(wide.port, "wrong")[0] == 429
    assert signed_in(wide.port, code_of(wide))[0] == 429


def test_a_header_does_not_make_a_client_another_one(wide):
    assert [signed_in(wide.port, "wrong", **{"X-Forwarded-For": f"10.0.0.{i}"})[0] for i in range(6)] == [403] * 5 + [
        429
    ]


def test_the_terminal_names_who_used_the_link_by_its_address(wide):
    assert signed_in(wide.port, code_of(wide), **{"X-Forwarded-For": "the phone in the lab"})[0] == 200
    told = next(line for line in wide.process.stdout if not line.startswith("ready "))
    assert told.startswith("the link was used by 127.0.0.1;")


def test_a_first_message_that_is_no_text_or_too_long_is_refused_and_no_fault(panel):
    assert close_code(panel.port, {"page": "\ud800"}) == 4404
    assert close_code(panel.port, {"page": "x" * (1 << 16)}) == 1009
    assert panel.end() == ""


def test_a_mistyped_path_is_not_in_the_log(wide, tmp_path):
    for path in ("/token-of-the-test", "/x?token-of-the-test", "/enter/token-of-the-test"):
        assert status_of(wide.port, path) == 404
    assert status_of(wide.port, "/?token=token-of-the-test") == 403
    wide.end()
    assert "token-of-the-test" not in "".join(p.read_text() for p in tmp_path.rglob("panel.log*"))


def test_a_page_of_another_site_is_refused(panel):
    host = f"127.0.0.1:{panel.port}"
    assert not refused(panel.port, Origin=f"http://{host}")
    assert refused(panel.port, Origin="http://example.org")
    assert status_of(panel.port, "/stop", Origin="http://example.org") == 403


@pytest.mark.parametrize(
    ("site", "mode", "dest", "status"),
    [
        ("same-origin", "cors", "empty", 200),
        ("none", "navigate", "document", 200),
        ("cross-site", "navigate", "document", 200),
        ("cross-site", "navigate", "iframe", 403),
        ("cross-site", "no-cors", "image", 403),
        ("same-site", "cors", "empty", 403),
    ],
)
def test_what_another_site_asks_for_is_refused_but_for_a_link_that_is_followed(panel, site, mode, dest, status):
    headers = {"Sec-Fetch-Site": site, "Sec-Fetch-Mode": mode, "Sec-Fetch-Dest": dest}
    assert status_of(panel.port, "/", **headers) == status


@pytest.mark.parametrize("path", ["/", "/panel/panel.js", "/none", "/_nicegui/none"])
def test_every_answer_forbids_frames_and_foreign_scripts(panel, path):
    assert_hardened(panel.port, path)


def test_the_refusal_and_the_sign_in_do_so_too(wide):
    assert_hardened(wide.port, "/")
    assert_hardened(wide.port, "/enter")
    assert_hardened(wide.port, "/panel/panel.js")


def assert_hardened(port: int, path: str) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", port)
    connection.request("GET", path)
    headers = connection.getresponse().headers
    connection.close()
    assert headers["x-frame-options"] == "DENY"
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert "'unsafe-inline'" not in headers["content-security-policy"].partition("script-src")[2]
    assert headers["cross-origin-opener-policy"] == headers["cross-origin-resource-policy"] == "same-origin"


@pytest.mark.full
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have 127.0.0.1 only")
def test_any_loopback_address_can_be_listened_to(open_page, board, tmp_path, panel_options):
    panel = Panel(str(board.link), tmp_path, "--host", "127.0.0.2", *panel_options)
    try:
        assert panel.url.startswith("http://127.0.0.2:")
        press(open_page(panel.url).get_by_role("button", name="UP", exact=True))
        wait_for_motion(board)
    finally:
        panel.kill()


def test_another_name_for_this_computer_is_refused(panel):
    """A site may give its own name this computer's address, to get round the rule of one origin."""
    assert status_of(panel.port, Host=f"localhost:{panel.port}") == 200
    assert status_of(panel.port, Host="example.org") == 403


def test_the_loopback_interface_is_all_that_it_listens_to_unless_told(panel):
    assert panel.url.startswith("http://127.0.0.1:")


@pytest.mark.parametrize("headers", [{"Host": "[::1"}, {"Origin": "http://[x"}])
def test_a_malformed_address_is_refused_and_is_no_fault(panel, headers):
    assert status_of(panel.port, **headers) == 403
    assert panel.end() == ""


@pytest.mark.parametrize("other", ["[x]=1", 'settings={"a": "b', "=", "x=\xff"])
def test_a_cookie_of_another_program_on_this_computer_does_not_shut_anybody_out(wide, other):
    assert status_of(wide.port, Cookie=f"{other}; {signed_in(wide.port, code_of(wide))[1]}") == 200


def test_two_panels_of_one_computer_can_be_open_in_one_browser(wide, tmp_path):
    second = Panel("virtual://", tmp_path, "--host", "0.0.0.0")
    try:
        jar = dict(signed_in(panel.port, code_of(panel))[1].split("=") for panel in (wide, second))
        both = "; ".join(f"{name}={value}" for name, value in jar.items())
        assert [status_of(panel.port, Cookie=both) for panel in (wide, second)] == [200, 200]
        one = f"{(jar := list(jar.items()))[1][0]}={jar[1][1]}"
        assert status_of(wide.port, Cookie=one) == 403
    finally:
        second.kill()
