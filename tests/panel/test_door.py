"""Who may come in to the panel."""

import http.client
import re

import pytest
from running import Panel
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect


@pytest.fixture
def wide(board, tmp_path):
    panel = Panel(str(board.link), tmp_path, "--host", "0.0.0.0")
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
        socket = connect(f"ws://127.0.0.1:{port}/drive/x", additional_headers=headers, proxy=None)
    except InvalidStatus as e:
        return e.response.status_code == 403
    with socket, pytest.raises(ConnectionClosed):
        socket.recv()
    assert socket.close_code == 4404  # let in, and told that there is no such page
    return False


def test_a_wider_network_makes_a_token_and_prints_the_link(wide):
    assert re.fullmatch(r"http://[0-9.]+:\d+/\?token=[\w-]{20,}", wide.url)
    assert any("whoever has this link can drive" in line for line in wide.said)


def test_the_link_with_the_token_opens_the_panel(open_page, wide, board):
    page = open_page(wide.url)
    assert "token" not in page.url
    page.get_by_role("button", name="UP", exact=True).click()
    page.get_by_text("+1.000").wait_for()


@pytest.mark.parametrize("link", ["/", "/?token=", "/?token=wrong", "/?token=%ff%00", "/stop", "/panel/panel.js"])
def test_without_the_right_token_nothing_is_shown(wide, link):
    port = int(wide.url.split(":")[2].split("/")[0])
    assert status_of(port, link) == 403


def test_without_the_token_the_driving_socket_is_refused(wide):
    port = int(wide.url.split(":")[2].split("/")[0])
    assert refused(port)
    assert refused(port, Cookie="mirrormount_panel=wrong")


def test_a_page_of_another_site_is_refused(panel):
    host = f"127.0.0.1:{panel.port}"
    assert not refused(panel.port, Origin=f"http://{host}")
    assert refused(panel.port, Origin="http://example.org")
    assert status_of(panel.port, "/stop", Origin="http://example.org") == 403


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


def cookie_of(url: str) -> str:
    """What the link gives."""
    address, _, path = url.removeprefix("http://").partition("/")
    connection = http.client.HTTPConnection(address)
    connection.request("GET", "/" + path)
    cookie = connection.getresponse().headers["set-cookie"].partition(";")[0]
    connection.close()
    return cookie


def port_of(url: str) -> int:
    return int(url.split(":")[2].split("/")[0])


@pytest.mark.parametrize("other", ["[x]=1", 'settings={"a": "b', "=", "x=\xff"])
def test_a_cookie_of_another_program_on_this_computer_does_not_shut_anybody_out(wide, other):
    assert status_of(port_of(wide.url), Cookie=f"{other}; {cookie_of(wide.url)}") == 200


def test_two_panels_of_one_computer_can_be_open_in_one_browser(wide, tmp_path):
    second = Panel("virtual://", tmp_path, "--host", "0.0.0.0")
    try:
        jar = dict(cookie_of(panel.url).split("=") for panel in (wide, second))
        both = "; ".join(f"{name}={value}" for name, value in jar.items())
        assert [status_of(port_of(panel.url), Cookie=both) for panel in (wide, second)] == [200, 200]
        one = cookie_of(second.url)
        assert status_of(port_of(wide.url), Cookie=one) == 403
    finally:
        second.kill()
