"""`mirrormount panel` before it serves: what it takes, and what it refuses in one line."""

import io
import socket

import pytest

from mirrormount.cli import main
from mirrormount_panel import cli
from mirrormount_panel import cli as panel


class Terminal(io.StringIO):
    """Somebody at a keyboard."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def served(monkeypatch):
    """What would be served, instead of serving it: (board's address, links)."""
    calls = []

    def serve(supervisors, opening, browser, view):
        (address,) = supervisors.values()
        calls.append((address, opening.addresses, opening.sign_in.token))

    monkeypatch.setattr(panel, "_serve", serve)
    monkeypatch.setattr(panel, "Supervisor", lambda address, patience_s: address)
    monkeypatch.setattr(panel, "find", list)
    monkeypatch.delenv("MIRRORMOUNT_PORT", raising=False)
    monkeypatch.delenv("MIRRORMOUNT_TOKEN", raising=False)
    return calls


def test_without_a_board_the_line_names_the_virtual_one(served, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main.main(["panel", "--http", "0"]) == 1
    assert "mirrormount panel --virtual" in capsys.readouterr().err
    assert served == []


@pytest.mark.parametrize(
    ("answer", "address"), [("y\n", ["virtual://"]), ("Yes\n", ["virtual://"]), ("\n", []), ("n\n", []), ("", [])]
)
def test_at_a_terminal_the_virtual_board_is_offered(served, monkeypatch, answer, address):
    monkeypatch.setattr("sys.stdin", Terminal(answer))
    assert main.main(["panel", "--http", "0"]) == (0 if address else 1)
    assert [call[0] for call in served] == address


def test_without_a_standard_input_nobody_is_asked(served, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", None)
    assert main.main(["panel", "--http", "0"]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_the_links_are_of_the_family_that_is_listened_to(served):
    try:
        assert main.main(["panel", "--virtual", "--http", "0", "--host", "::"]) == 0
    except OSError:
        pytest.skip("no IPv6")
    assert all(link.startswith("http://[") for link in served[0][1])


def test_the_only_mount_of_a_table_is_taken_and_of_several_all(served, monkeypatch, tmp_path):
    monkeypatch.setenv("MIRRORMOUNT_TABLE", str(tmp_path / "table.toml"))
    opened = []
    monkeypatch.setattr(panel, "of_table", lambda mounts, _s: opened.append([*mounts]) or {"": None})
    for names in (["one"], ["one", "two"]):
        (tmp_path / "table.toml").write_text("".join(f'[mounts.{name}]\nport = "/dev/{name}"\n' for name in names))
        assert main.main(["panel", "--http", "0"]) == 0
    assert served[0][0] == "one" and opened == [["one", "two"]]


def test_an_encoder_is_of_the_virtual_board(served):
    assert main.main(["panel", "--virtual", "--encoder", "shaft", "--http", "0"]) == 0
    assert served[0][0] == "virtual://?profile=hardware&encoder=shaft"


def test_a_port_that_is_named_is_taken(served):
    assert main.main(["panel", "/dev/ttyACM7", "--http", "0"]) == 0
    assert served[0][0] == "/dev/ttyACM7"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["/dev/ttyACM0", "--virtual"], "leave the port out"),
        (["/dev/ttyACM0", "--encoder", "motor"], "--encoder: of a virtual board; add --virtual"),
        (["--mounts", "2"], "--mounts: of virtual boards; add --virtual"),
        (["--virtual", "--mounts", "2", "--camera", "1"], "moves the spot by one mount"),
        (["--virtual", "--http", "http"], "--http is a port number"),
        (["--virtual", "--http", "65536"], "--http is a port number"),
        (["--virtual", "--http", "9" * 5000], "--http is a port number"),
        (["--virtual", "--patience", "5"], "--patience is 0.1 to 2 seconds"),
        (["--virtual", "--patience", "nan"], "--patience is 0.1 to 2 seconds"),
        (["--virtual", "--host", "no.such.host.invalid"], "no such host"),
        (["--virtual", "--http", "0", "--token", " x"], "a token is"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(served, capsys, arguments, told):
    assert main.main(["panel", *arguments]) == 1
    err = capsys.readouterr().err
    assert told in err and len(err.splitlines()) == 1
    assert served == []


def test_a_port_in_use_is_told_if_it_was_asked_for_and_passed_over_if_not(served, monkeypatch, capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        number = taken.getsockname()[1]
        assert main.main(["panel", "--virtual", "--http", str(number)]) == 1
        assert "take another port" in capsys.readouterr().err
        monkeypatch.setattr(cli, "_PORT", number)
        assert main.main(["panel", "--virtual"]) == 0
    assert not served[0][1][0].endswith(f":{number}/")


def test_loopback_needs_no_token_and_a_wider_network_makes_a_new_one_each_time(served):
    for host in ("127.0.0.1", "0.0.0.0", "0.0.0.0"):
        assert main.main(["panel", "--virtual", "--http", "0", "--host", host]) == 0
    tokens = [token for _, _, token in served]
    assert tokens[0] is None
    assert tokens[1] and tokens[2] and tokens[1] != tokens[2]


def test_a_token_in_the_command_line_and_a_short_one_are_warned_of(served, capsys):
    assert main.main(["panel", "--virtual", "--http", "0", "--token", "mirror"]) == 0
    assert served[0][2] == b"mirror"
    warned = capsys.readouterr().err
    assert "list of processes" in warned and "can be guessed" in warned and len(warned.splitlines()) == 2


def test_a_long_token_of_a_file_is_taken_without_a_word(served, capsys, tmp_path):
    (tmp_path / "token").write_text("kKq3-0d7LbX_u2mTzR9sWg\n")
    assert main.main(["panel", "--virtual", "--http", "0", "--token-file", str(tmp_path / "token")]) == 0
    assert served[0][2] == b"kKq3-0d7LbX_u2mTzR9sWg"
    assert capsys.readouterr().err == ""


def test_without_nicegui_the_line_says_what_to_install(served, monkeypatch, capsys):
    monkeypatch.setattr(panel.importlib.util, "find_spec", lambda _name: None)
    assert main.main(["panel", "--virtual"]) == 1
    assert '[panel]"' in capsys.readouterr().err
