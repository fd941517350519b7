"""`mirrormount stop` without a port that somebody has typed: every mount that may be there is stopped."""

import os
import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest
from served import HANG_S, PATIENCE_S, wait_for

import mirrormount.transport.discovery
from mirrormount.cli import main, stop
from mirrormount.device.session import Session

# on a busy computer a board in real time answers later than its client waits
pytestmark = pytest.mark.usefixtures("runtime")


def plug_in(monkeypatch, *addresses: object) -> None:
    """These look like boards with MicroPython, and nothing else is plugged in."""
    ports = [SimpleNamespace(device=str(a), vid=0x2E8A, pid=5, serial_number=None) for a in addresses]
    monkeypatch.setattr(mirrormount.transport.discovery.list_ports, "comports", lambda: ports)


@pytest.fixture(autouse=True)
def nothing_else(tmp_path, monkeypatch) -> None:
    """No table, no port in the environment, and nothing plugged in yet."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))
    for name in ("MIRRORMOUNT_TABLE", "MIRRORMOUNT_PORT"):
        monkeypatch.delenv(name, raising=False)
    plug_in(monkeypatch)


@pytest.fixture
def mute():
    """A serial port of another instrument, which answers nothing; heard(): what was written to it."""
    ours, theirs = os.openpty()
    yield SimpleNamespace(address=os.ttyname(theirs), heard=lambda: os.read(ours, 1 << 16))
    os.close(ours)
    os.close(theirs)


def leave_running(board) -> None:
    """A motor that runs on, without a program that has the port."""
    with open(board.link, "wb", buffering=0) as raw:
        raw.write(b"1XM60000;1MV+\n")
    wait_for(board.driving, "the motor to run")


def test_each_board_that_is_plugged_in_is_stopped(serve, monkeypatch, capsys):
    boards = [serve(), serve()]
    for board in boards:
        leave_running(board)
    plug_in(monkeypatch, *(board.link for board in boards))
    assert main.main(["stop"]) == 0
    wait_for(lambda: not any(board.driving() for board in boards), "the stops")
    assert sorted(capsys.readouterr().out.splitlines()) == sorted(f"{board.link}: stopped" for board in boards)


def test_a_port_in_the_environment_hides_no_other_board(serve, monkeypatch, capsys):
    named, other = serve(), serve()
    leave_running(other)
    plug_in(monkeypatch, other.link)
    monkeypatch.setenv("MIRRORMOUNT_PORT", str(named.link))
    assert main.main(["stop"]) == 0
    wait_for(lambda: not other.driving(), "the stop")
    assert sorted(capsys.readouterr().out.splitlines()) == sorted(f"{b.link}: stopped" for b in (named, other))


def test_a_port_that_is_typed_is_the_only_one(serve, monkeypatch, capsys):
    meant, other = serve(), serve()
    leave_running(other)
    plug_in(monkeypatch, other.link)
    assert main.main(["stop", "--port", str(meant.link)]) == 0
    assert other.driving()
    assert capsys.readouterr().out == "stopped\n"


def test_a_board_that_goes_by_two_names_is_stopped_once(board, monkeypatch, capsys):
    plug_in(monkeypatch, os.path.realpath(board.link))
    monkeypatch.setenv("MIRRORMOUNT_PORT", str(board.link))
    assert main.main(["stop"]) == 0
    assert capsys.readouterr().out == "stopped\n"


def test_of_several_boards_the_one_that_is_no_mount_is_told_and_its_program_is_not_interrupted(
    board, mute, monkeypatch, capsys
):
    plug_in(monkeypatch, board.link, mute.address)
    assert main.main(["stop"]) == 1
    said = capsys.readouterr()
    assert said.out == f"{board.link}: stopped\n"
    assert f"{mute.address}: nothing answers" in said.err
    assert f"if it is one, name it (mirrormount stop --port {mute.address})" in said.err
    assert b"\x03" not in mute.heard()


def test_beside_a_mount_that_is_named_another_instrument_is_told_and_is_no_failure(board, mute, monkeypatch, capsys):
    plug_in(monkeypatch, mute.address)
    monkeypatch.setenv("MIRRORMOUNT_PORT", str(board.link))
    assert main.main(["stop"]) == 0
    said = capsys.readouterr()
    assert f"{board.link}: stopped\n" in said.out
    assert f"left alone: {mute.address}: nothing answers" in said.out
    assert said.err == ""


def test_beside_a_mount_that_is_named_a_board_that_cannot_be_stopped_is_a_failure(serve, monkeypatch, capsys):
    import serial

    named, other = serve(), serve()
    plug_in(monkeypatch, other.link)
    monkeypatch.setenv("MIRRORMOUNT_PORT", str(named.link))
    with serial.Serial(str(other.link), exclusive=True):
        assert main.main(["stop"]) == 1
    said = capsys.readouterr()
    assert said.out == f"{named.link}: stopped\n" and f"{other.link}: another program" in said.err


def test_a_virtual_board_in_the_environment_is_no_board_beside_a_real_one(board, monkeypatch, capsys):
    leave_running(board)
    plug_in(monkeypatch, board.link)
    monkeypatch.setenv("MIRRORMOUNT_PORT", "virtual://")
    assert main.main(["stop"]) == 0
    assert capsys.readouterr().out == "stopped\n"
    wait_for(lambda: not board.driving(), "the stop")


def test_a_program_that_opens_a_port_while_others_are_asked_is_asked_too(board, holder, monkeypatch, capsys):
    looked_for = stop._every_port

    def late(of_environment):
        holder(str(board.link), "m.send('2XM60000'); m.x.jog(1)")
        wait_for(board.driving, "the motor to run")
        return looked_for(of_environment)

    monkeypatch.setattr(stop, "_every_port", late)
    monkeypatch.setenv("MIRRORMOUNT_PORT", str(board.link))
    assert main.main(["stop"]) == 0
    wait_for(lambda: not board.driving(), "the stop")
    assert capsys.readouterr().out.startswith("stopped (by process ")


def test_a_program_that_does_not_answer_delays_no_other_boards_stop(board, monkeypatch):
    opened = threading.Event()
    monkeypatch.setattr(Session, "open", lambda _address: opened.set() or SimpleNamespace(close=str))
    monkeypatch.setattr(stop, "_ask", lambda _owner: "stopped" if opened.wait(PATIENCE_S) else pytest.fail("it waited"))
    monkeypatch.setattr(stop, "owners", lambda address=None: [] if address else [stop.Owner(1, "a program")])
    plug_in(monkeypatch, board.link)
    assert main.main(["stop"]) == 0


def test_what_cannot_be_printed_keeps_no_board_from_its_stop(board, holder, serve):
    other = serve()
    holder(str(other.link))
    leave_running(board)
    environment = os.environ | {"MIRRORMOUNT_PORT": str(board.link)}
    with open("/dev/full", "wb", buffering=0) as full:
        words = [sys.executable, "-m", "mirrormount", "stop"]
        run = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, env=environment, timeout=HANG_S)
    wait_for(lambda: not board.driving(), "the stop")
    assert run.returncode == 1 and run.stderr.startswith(b"mirrormount: standard output: ")


def test_ctrl_c_does_not_say_that_all_have_stopped(monkeypatch, capsys):
    def interrupted(_of_environment):
        raise KeyboardInterrupt

    monkeypatch.setattr(stop, "_every_port", interrupted)
    assert main.main(["stop"]) == 130
    assert capsys.readouterr().err == "mirrormount: interrupted: not every mount is known to have stopped\n"


def test_all_are_stopped_at_the_same_time(monkeypatch, capsys):
    together = threading.Barrier(2, timeout=PATIENCE_S)
    monkeypatch.setattr(Session, "open", lambda address: together.wait() is not None and SimpleNamespace(close=str))
    plug_in(monkeypatch, "/dev/ttyACM0", "/dev/ttyACM1")
    assert main.main(["stop"]) == 0
    assert sorted(capsys.readouterr().out.splitlines()) == ["/dev/ttyACM0: stopped", "/dev/ttyACM1: stopped"]


def test_nothing_to_stop_is_said_with_a_remedy(capsys):
    assert main.main(["stop"]) == 1
    assert "no board found: plug one in" in capsys.readouterr().err
