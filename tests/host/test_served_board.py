"""A served board and clients in processes of their own: what dies, freezes or floods stops nothing but itself."""

import contextlib
import json
import os
import pty
import signal
import socket
import stat
import subprocess
import sys

import pytest
from served import PATIENCE_S, ServedBoard, run_cli, wait_for

from mirrormount import errors
from mirrormount.device.mount import Mount
from mirrormount.transport import ports

KEEP_ALIVE_US = 500_000


def client(code: str, address: str) -> subprocess.Popen:
    """A Python process that has an open mount `m`, and says "moving" on its stdout when asked to."""
    program = f"""
from mirrormount import Mount
m = Mount.open({address!r})
{code}
print('moving', flush=True)
input()
"""
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "moving\n"
    return process


def finish(process: subprocess.Popen) -> None:
    process.kill()
    process.communicate()


def test_it_says_where_it_is_and_ends_cleanly_on_both_signals(serve):
    for number in (signal.SIGTERM, signal.SIGINT):
        board = serve()
        assert os.path.islink(board.link)
        assert board.end(number) == 0
        assert not os.path.lexists(board.link)


def test_the_edges_file_has_the_documented_form(board):
    with Mount.open(str(board.link)) as mount:
        mount.y.step(-1)
    edges = board.edges()
    assert [(e["pin"], e.get("duty", e.get("level"))) for e in edges[:4]] == [
        ("m1_neg", 1),
        ("m1_en", 65535),
        ("m1_en", 0),
        ("m1_neg", 0),
    ]
    assert all(set(e) == {"t_us", "pin", "duty" if e["pin"].endswith("_en") else "level"} for e in edges)


def test_legs_of_a_two_pwm_bridge_are_written_with_their_duty(serve):
    board = serve("--board", "pico_drv8833")
    with Mount.open(str(board.link)) as mount:
        mount.y.step(1)
    assert [(e["pin"], e["duty"]) for e in board.edges()] == [("m1_pos", 65535), ("m1_pos", 0)]


@pytest.mark.parametrize("how", ["link", "tcp"])
def test_a_client_killed_in_mid_jog_stops_the_mount_within_the_keep_alive(board, how):
    process = client("m.x.jog(1)", str(getattr(board, how)))
    wait_for(board.driving, "the motor to run")
    process.send_signal(signal.SIGKILL)
    wait_for(lambda: not board.driving(), "the keep-alive to stop it")
    finish(process)
    with Mount.open(str(getattr(board, how))) as mount:
        assert mount.status().x.reason == 7


def test_a_frozen_client_stops_the_mount_within_the_keep_alive(board):
    process = client("m.x.jog(1)", board.tcp)
    wait_for(board.driving, "the motor to run")
    process.send_signal(signal.SIGSTOP)
    wait_for(lambda: not board.driving(), "the keep-alive to stop it")
    finish(process)
    with Mount.open(board.tcp) as mount:
        assert mount.status().x.reason == 7


def test_the_keep_alive_counts_from_the_last_byte_of_the_dead_client(board):
    # no feeder here: one line starts the motion, then silence, so the on-time is the keep-alive
    with socket.create_connection(("127.0.0.1", int(board.tcp.rsplit(":", 1)[1]))) as raw:
        raw.sendall(b"XK500;2MV+\n")
        wait_for(board.driving, "the motor to run")
        wait_for(lambda: not board.driving(), "the keep-alive to stop it")
    assert abs(board.off_after_us("m2_en") - KEEP_ALIVE_US) < 5_000


def test_a_frame_client_killed_stops_at_the_run_limit(board):
    with socket.create_connection(("127.0.0.1", int(board.tcp.rsplit(":", 1)[1]))) as raw:
        raw.sendall(b"1XM700\n02550000")
        wait_for(board.driving, "the motor to run")
    wait_for(lambda: not board.driving(), "the run limit to stop it")
    assert abs(board.off_after_us("m1_en") - 700_000) < 5_000


def test_a_dead_clients_keep_alive_does_not_cut_the_next_client(board):
    finish(client("m.x.step(1)", board.tcp))
    with Mount.open(board.tcp) as mount:
        mount.ask("1XM1500;XK?")
        mount.y.jog(1)
        assert mount.y.wait().reason == 6
    assert abs(board.off_after_us("m1_en") - 1_500_000) < 5_000


@pytest.mark.parametrize("how", ["link", "tcp"])
def test_a_host_that_never_reads_ten_thousand_frames_then_a_stop(board, how):
    if how == "link":
        fd = os.open(board.link, os.O_RDWR | os.O_NOCTTY)
        send, close = (lambda data: os.write(fd, data)), (lambda: os.close(fd))
    else:
        raw = socket.create_connection(("127.0.0.1", int(board.tcp.rsplit(":", 1)[1])))
        send, close = raw.send, raw.close
    flood = b"02550255" * 10_000
    while flood:
        flood = flood[send(flood) :]
    wait_for(board.driving, "the motors to run")
    send(b"!")
    wait_for(lambda: not board.driving(), "the stop")
    # nothing comes after it: the stop was the last thing, and it was obeyed
    with_stop = board.edges()
    close()
    with Mount.open(str(getattr(board, how))) as mount:
        status = mount.status()
        assert not status.moving and (status.x.reason, status.y.reason) == (3, 3)  # not by the run limit
    assert board.edges() == with_stop


def test_whoever_writes_a_stop_and_leaves_at_once_is_heard(board):
    with open(board.link, "wb", buffering=0) as port:
        port.write(b"1XM60000\n02550255")
    wait_for(lambda: all(board.enables().values()), "the motors to run")
    with open(board.link, "wb", buffering=0) as port:
        port.write(b"!")
    wait_for(lambda: not board.driving(), "the stop")


def test_a_second_tcp_client_is_told_and_turned_away(board):
    where = ("127.0.0.1", int(board.tcp.rsplit(":", 1)[1]))
    with socket.create_connection(where, PATIENCE_S) as first:
        first.sendall(b"1TP?\n")
        assert first.recv(100) == b"0\r\n"
        with pytest.raises(errors.PortBusy, match="another"):
            Mount.open(board.tcp)
        first.sendall(b"1MD?\n")
        assert first.recv(100) == b"1\r\n"


def test_a_second_program_on_the_pty_is_told_that_it_is_busy(board):
    with Mount.open(str(board.link)), pytest.raises(errors.PortBusy):
        Mount.open(str(board.link))


def test_a_board_that_goes_in_mid_move_is_one_clear_error(board):
    with pytest.raises(errors.ConnectionLost) as lost, Mount.open(str(board.link)) as mount:  # noqa: PT012
        mount.x.jog(1)
        wait_for(board.driving, "the motor to run")
        board.kill()
        mount.x.wait()
    assert "\n" not in str(lost.value)


def test_the_link_of_a_killed_board_is_replaced_and_one_in_use_is_not(board):
    # alone, as all here: the number of a terminal that has gone may go to that of another test
    refused = run_cli("virtual", "--link", str(board.link))
    assert refused.returncode == 1
    assert "leads to a terminal in use" in refused.stderr and board.link.is_symlink()
    board.kill()
    assert board.link.is_symlink() and not board.link.exists()
    with ServedBoard(board.link.parent) as again, Mount.open(str(again.link)) as mount:
        assert mount.x.position == 0


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the time at which a terminal was made is not known")
def test_the_link_of_a_killed_board_leads_to_no_other_terminal(tmp_path, monkeypatch):
    monkeypatch.setattr(ports, "_CLOCKS_S", 0.0)
    link, clock = tmp_path / "mount", tmp_path / "clock"
    with contextlib.closing(Terminal()) as before:
        number = before.name
    for _ in range(100):  # another program of this computer may be faster
        link.unlink(missing_ok=True)
        link.symlink_to(number)  # as the board has left it
        clock.touch()
        while clock.stat().st_ctime <= link.lstat().st_ctime:
            clock.touch()
        with contextlib.closing(Terminal()) as other:
            if other.name != number:
                number = other.name
                continue
            with pytest.raises(errors.PortAbsent, match="younger than this link: the virtual board that made it was"):
                Mount.open(str(link))
            os.set_blocking(other.ours, False)
            with pytest.raises(BlockingIOError):
                os.read(other.ours, 1)
            return
    pytest.fail("no terminal has had the number of the one before")


class Terminal:
    """A pseudo-terminal of another program; its number is free again after close()."""

    def __init__(self) -> None:
        self.ours, self._slave = pty.openpty()
        self.name = os.ttyname(self._slave)

    def close(self) -> None:
        os.close(self.ours)
        os.close(self._slave)


def until(port, text: bytes) -> bytes:
    """Read from an open file until text has come."""
    seen = b""
    while text not in seen:
        seen += port.read(4096)
    return seen


def raw_socket(board) -> socket.socket:
    return socket.create_connection(("127.0.0.1", int(board.tcp.rsplit(":", 1)[1])))


def test_ctrl_c_from_a_terminal_turns_the_motors_off_and_gives_the_prompt(board):
    with open(board.link, "r+b", buffering=0) as raw:
        raw.write(b"02550255")
        wait_for(lambda: all(board.enables().values()), "the motors to run")
        raw.write(b"\x03")
        wait_for(lambda: not board.driving(), "the motors to stop")
        until(raw, b">>> ")
    with pytest.raises(errors.AtPrompt, match="Ctrl-D"):
        Mount.open(str(board.link))
    with pytest.raises(errors.AtPrompt, match="pty"):
        Mount.open(board.tcp)


def test_ctrl_d_at_the_prompt_starts_the_firmware_again(board):
    with open(board.link, "r+b", buffering=0) as raw:
        raw.write(b"\x03")
        until(raw, b">>> ")
        raw.write(b"\x04")
        until(raw, b"soft reboot")
    with Mount.open(board.tcp) as mount:
        mount.x.step(1)
        assert mount.x.position == 1


MACHINES = ("cpython", "micropython", "circuitpython")


@pytest.mark.parametrize("machine", MACHINES)
def test_on_tcp_the_keys_of_the_prompt_do_not_exist_and_ctrl_c_is_a_stop(serve, machine):
    board = serve("--machine", machine)
    with raw_socket(board) as raw, raw.makefile("rb") as answers:
        raw.sendall(b"1XM60000;1MV+\n")
        wait_for(board.driving, "the motor to run")
        raw.sendall(b"\x03")
        wait_for(lambda: not board.driving(), "the stop")
        raw.sendall(b"\n\x01\x02\x04\x05import os\r\x04\n!\nTB?;1XE?\n")
        answer = answers.readline()
    assert answer.rstrip().split(b", ")[0].split(b"; ")[0] in (b"0", b"6", b"60") and b">>>" not in answer


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize(
    "begins", [b"GET / HTTP/1.1\r\n", b"POST / HTTP/1.1\r\n", b"PRI * HTTP/2.0\r\n\r\nSM", b"\x16\x03\x01\x02\x00"]
)
def test_who_begins_as_a_browser_or_tls_does_reaches_no_board(serve, machine, begins):
    board = serve("--machine", machine)
    with raw_socket(board) as raw:
        raw.sendall(begins + b"\x03\x03\r\n\r\n1XM60000;1MV+\n02550255\n")
        with contextlib.suppress(ConnectionResetError):
            assert raw.recv(100) == b""
    with Mount.open(board.tcp) as mount:
        assert mount.ask("1XM?") == "10000" and mount.take_errors() == []
    assert board.edges() == []


def test_a_board_at_its_prompt_obeys_nobody_on_tcp(serve):
    board = serve("--machine", "micropython")
    with open(board.link, "r+b", buffering=0) as raw:
        raw.write(b"\x03")
        until(raw, b">>> ")
    with raw_socket(board) as raw:
        raw.sendall(b"print(6*7)\r\n")
        said = b""
        with contextlib.suppress(ConnectionResetError):
            while data := raw.recv(100):
                said += data
    assert b"42" not in said and b"Python prompt" in said


def test_the_boards_pty_is_its_users_alone(board):
    assert stat.S_IMODE(os.stat(board.link).st_mode) == 0o600


def test_what_a_dead_client_left_unread_does_not_confuse_the_next(board):
    with socket.create_connection(("127.0.0.1", int(board.tcp.rsplit(":", 1)[1]))) as raw:
        raw.sendall(b"*IDN?\n" * 50 + b"02550255" * 20)
        wait_for(board.driving, "the motors to run")
    with Mount.open(board.tcp) as mount:
        assert mount.identity.startswith("mirrormount,")
        assert not mount.status().moving


def test_options_that_cannot_be_are_one_line(serve, tmp_path):
    (tmp_path / "file").write_text("mine")
    for options in (
        ["--tcp", "70000"],
        ["--tcp", "x"],
        ["--link", str(tmp_path / "file")],
        ["--link", str(tmp_path / "none" / "mount")],
        ["--tcp", "0", "--edges", str(tmp_path / "none" / "edges")],
        ["--link", ""],
        ["--tcp", "0", "--edges", ""],
        ["--tcp", "0", "--link", str(serve().link)],
    ):
        run = run_cli("virtual", *options)
        assert run.returncode == 1, options
        assert run.stderr.startswith("mirrormount: ") and run.stderr.count("\n") == 1, run.stderr
    assert (tmp_path / "file").read_text() == "mine"


def test_one_client_at_a_time_over_both_ports(board):
    with Mount.open(str(board.link)), pytest.raises(errors.PortBusy):
        Mount.open(board.tcp)
    with Mount.open(board.tcp), pytest.raises(errors.PortBusy):
        Mount.open(str(board.link))
    with Mount.open(str(board.link)) as mount:
        mount.x.step(1)


def test_switching_the_board_off_turns_the_motors_off_in_the_edges_too(serve):
    for number in (signal.SIGTERM, signal.SIGHUP):
        board = serve()
        with open(board.link, "wb", buffering=0) as raw:
            raw.write(b"1XM60000\n02550000")
        wait_for(board.driving, "the motor to run")
        assert board.end(number) == 0
        assert not board.driving()


def test_edges_that_cannot_be_written_end_the_board_in_one_line(tmp_path):
    board = subprocess.Popen(
        [sys.executable, "-m", "mirrormount", "virtual", "--tcp", "0", "--edges", "/dev/full"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    address = board.stdout.readline().split()[1]
    with socket.create_connection(("127.0.0.1", int(address.rsplit(":", 1)[1]))) as raw:
        raw.sendall(b"02550000")
        _, err = board.communicate(timeout=PATIENCE_S)
    assert board.returncode == 1
    assert err.count("\n") == 1 and "No space left" in err


def test_a_port_in_use_is_one_line(board):
    port = board.tcp.rsplit(":", 1)[1]
    run = run_cli("virtual", "--tcp", port)
    assert run.returncode == 1
    assert run.stderr.count("\n") == 1 and port in run.stderr


def test_every_edge_is_a_json_object_on_a_line_of_its_own(board):
    with Mount.open(str(board.link)) as mount:
        mount.drive(100, -100)
    for line in board.edges_file.read_text().splitlines():
        assert isinstance(json.loads(line), dict)
