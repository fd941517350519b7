"""A stop that another program asks for while a port is in use: who may, how it gets through, and what it says."""

import errno
import os
import signal
import socket
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from served import PATIENCE_S, run_cli, wait_for

from mirrormount import errors
from mirrormount.cli import main
from mirrormount.device import table_file
from mirrormount.device.mount import Mount
from mirrormount.transport import stop_socket
from mirrormount.transport.stop_socket import SENT, STOPPED, StopListener, ask, held_here, owners

if os.name != "posix":
    pytest.skip("Unix sockets need POSIX", allow_module_level=True)

# on a busy computer a board in real time answers later than its client waits
pytestmark = pytest.mark.usefixtures("runtime")


@pytest.mark.parametrize("port", [True, False])
def test_stop_gets_through_a_program_that_has_the_port(board, holder, port):
    process = holder(str(board.link), "m.send('1XM60000;2XM60000'); m.x.jog(1)")
    wait_for(board.driving, "the motor to run")
    run = run_cli("stop", *(["--port", str(board.link)] if port else []))
    assert not board.driving()
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.startswith("stopped (by process ") and str(process.pid) in run.stdout


def test_stop_gets_through_while_a_thread_holds_the_link(board, holder):
    hold = "t = threading.Thread(target=m.link.lock.acquire); t.start(); t.join()"  # and never gives it back
    holder(str(board.link), f"m.send('2XM60000;XK0;2MV+'); {hold}")
    wait_for(board.driving, "the motor to run")
    run = run_cli("stop")
    wait_for(lambda: not board.driving(), "the stop")
    assert run.returncode == 0 and run.stdout.startswith("stop sent")


def test_a_frozen_program_is_named_and_the_keep_alive_ends_what_moves(board, holder):
    process = holder(str(board.link), "m.send('1XM60000;2XM60000'); m.x.jog(1)")
    wait_for(board.driving, "the motor to run")
    process.send_signal(signal.SIGSTOP)
    run = run_cli("stop")
    assert run.returncode == 1 and run.stdout == ""
    assert f"process {process.pid}" in run.stderr and "keep-alive" in run.stderr and run.stderr.count("\n") == 1
    wait_for(lambda: not board.driving(), "the keep-alive")


def test_a_motion_that_was_about_to_start_does_not_start_after_the_stop(board):
    with Mount.open(str(board.link)) as mount:
        stops = mount.session.gate.last_stop()
        assert ask(owners(str(board.link))[0]) == STOPPED
        with pytest.raises(errors.MoveEnded):
            mount.session.start("1MV+", stops)
    assert not board.edges()


def test_two_programs_are_both_stopped_when_no_port_is_named(serve, holder):
    boards = [serve(), serve()]
    for board in boards:
        holder(str(board.link), "m.send('1XM60000;2XM60000'); m.x.jog(1)")
    run = run_cli("stop")
    assert run.returncode == 0 and run.stdout.count("stopped (by") == 2
    assert not any(board.driving() for board in boards)


def test_a_port_that_is_in_use_is_refused_with_the_name_of_the_program(board, holder):
    process = holder(str(board.link))
    with pytest.raises(errors.PortBusy, match=rf"process {process.pid} \(python"):
        Mount.open(str(board.link))


def test_a_port_goes_by_its_real_path_and_is_known_to_its_process_while_open(board, tmp_path):
    other = tmp_path / "another-name"
    other.symlink_to(board.link)
    with Mount.open(str(board.link)):
        assert held_here(str(other)) and len(owners(str(other))) == 1
    assert not held_here(str(board.link)) and not owners()


def test_only_this_user_gets_at_the_socket(runtime):
    owner = StopListener(["/dev/ttyTEST"], lambda: SENT)
    try:
        (path,) = runtime.iterdir()
        assert stat.S_IMODE(runtime.stat().st_mode) == 0o700
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    finally:
        owner.close()
    assert list(runtime.iterdir()) == []


def test_a_folder_that_others_can_read_is_closed_to_them(runtime):
    runtime.mkdir(mode=0o777)
    runtime.chmod(0o777)
    StopListener(["/dev/ttyTEST"], lambda: SENT).close()
    assert stat.S_IMODE(runtime.stat().st_mode) == 0o700


def test_what_a_killed_program_left_is_removed(board, holder, runtime):
    process = holder(str(board.link))
    process.kill()
    process.wait(PATIENCE_S)
    assert len(list(runtime.iterdir())) == 1
    assert owners() == [] and list(runtime.iterdir()) == []


def test_looking_for_owners_stops_nothing_and_neither_does_silence(runtime):
    stops = []
    owner = StopListener(["/dev/ttyTEST", "socket://127.0.0.1:1"], lambda: stops.append(1) or SENT)
    try:
        (found,) = owners()
        assert found.pid == os.getpid()
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as silent:
            silent.connect(str(found.path))
            silent.sendall(b"no\n")
            assert silent.recv(10) == b"" and stops == []
        assert ask(owners("socket://127.0.0.1:1")[0]) == SENT and stops == [1]
    finally:
        owner.close()


def test_another_user_at_the_socket_stops_nothing(runtime, monkeypatch):
    stops = []
    owner = StopListener(["/dev/ttyTEST"], lambda: stops.append(1) or SENT)
    try:
        monkeypatch.setattr(stop_socket, "_user", lambda _connection: os.getuid() + 1)
        with pytest.raises(errors.NoAnswer, match="has the port"):
            ask(owners()[0])
        assert stops == []
    finally:
        owner.close()


def test_a_stop_goes_through_the_program_that_has_its_port(capsys):
    owner = StopListener(["/dev/ttyTEST"], lambda: STOPPED)
    try:
        assert main.main(["stop", "--port", "/dev/ttyTEST"]) == 0
        assert capsys.readouterr().out.startswith("stopped (by process ")
    finally:
        owner.close()


@pytest.fixture
def named(monkeypatch):
    """near, a mount of the table; its port is known, and its board is the one named."""

    def name(port: str, board: str) -> None:
        monkeypatch.setattr(table_file, "find_port", lambda _name: table_file.MountPort(port, None, board))

    return name


@pytest.mark.parametrize(("meant", "status"), [("e66AA", 0), ("e66bb", 1)])
def test_a_named_boards_stop_is_told_only_if_that_board_has_stopped(named, capsys, meant, status):
    stops = []
    owner = StopListener(["/dev/ttyTEST"], lambda: stops.append(1) or STOPPED, "e66aa")
    try:
        named("/dev/ttyTEST", meant)
        assert main.main(["stop", "--port", "near"]) == status
        assert stops == [1]  # the owner's own board, whichever was meant
        said = capsys.readouterr()
        assert said.out.endswith("which has the port; board e66aa)\n") == (not status)
        assert ("has stopped the board e66aa, not e66bb: that may still move" in said.err) == bool(status)
    finally:
        owner.close()


def test_another_board_at_a_free_port_is_stopped_and_that_is_no_stop_of_the_named_one(board, named, capsys):
    with open(board.link, "wb", buffering=0) as raw:
        raw.write(b"1XM60000;1MV+\n")
    wait_for(board.driving, "the motor to run")
    named(str(board.link), "e66bb")
    assert main.main(["stop", "--port", "near"]) == 1
    assert "has stopped, not e66bb: that may still move" in capsys.readouterr().err
    assert not board.driving()


def test_a_program_of_version_0_2_that_asks_gets_the_answer_that_it_knows():
    owner = StopListener(["/dev/ttyTEST"], lambda: STOPPED, "e66aa")
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asker:
            asker.connect(str(owners()[0].path))
            asker.sendall(b"stop\n")
            assert asker.recv(100) == b"stopped\n"
    finally:
        owner.close()


def test_an_owner_that_cannot_stop_says_why():
    def fail() -> str:
        raise errors.ConnectionLost("the port has gone")

    owner = StopListener(["/dev/ttyTEST"], fail)
    try:
        with pytest.raises(errors.NoAnswer, match="the port has gone"):
            ask(owners()[0])
    finally:
        owner.close()


def test_a_program_that_closes_the_port_as_it_is_asked_is_no_obstacle(board):
    with open(board.link, "wb", buffering=0) as raw:
        raw.write(b"1XM60000;1MV+\n")
    wait_for(board.driving, "the motor to run")

    def leave() -> str:
        owner.close()
        raise errors.ConnectionLost("this Mount was closed: open it again")

    owner = StopListener([str(board.link)], leave)
    run = run_cli("stop", "--port", str(board.link))
    assert (run.returncode, run.stdout, run.stderr) == (0, "stopped\n", "")
    assert not board.driving()


def test_a_port_works_where_no_socket_can_be_made(board, runtime):
    runtime.symlink_to("/nowhere/at/all")
    with Mount.open(str(board.link)) as mount:
        assert mount.session.stop_listener.why_not
        mount.x.step(1)


def test_many_askers_at_once_are_all_answered():
    owner = StopListener(["/dev/ttyTEST"], lambda: STOPPED)
    try:
        (found,) = owners()
        answers = []
        threads = [threading.Thread(target=lambda: answers.append(ask(found))) for _ in range(5)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert answers == [STOPPED] * 5
    finally:
        owner.close()


def test_stop_imports_next_to_nothing():
    code = (
        "import sys; from mirrormount.cli import main; main.parser(['stop']);"
        "from mirrormount.transport import stop_socket; print(*{m.partition('.')[0] for m in sys.modules})"
    )
    names = set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())
    assert "mirrormount" in names
    assert not names & {"numpy", "serial", "asyncio", "nicegui", "matplotlib", "mpremote", "http", "email", "ssl"}
    assert stop_socket.supported()


@pytest.fixture
def frozen(holder, serve):
    """Starts a program that has a board open and hangs."""

    def start() -> subprocess.Popen:
        process = holder(str(serve().link))
        process.send_signal(signal.SIGSTOP)
        return process

    return start


def test_a_frozen_program_is_named_however_often_it_is_asked(frozen):
    process = frozen()
    (owner,) = owners()
    crowd = [socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) for _ in range(20)]
    for asker in crowd:
        asker.setblocking(False)
        asker.connect_ex(str(owner.path))
    assert [found.pid for found in owners()] == [process.pid]
    with pytest.raises(errors.NoAnswer, match=f"process {process.pid} "):
        ask(owner, 0.1)
    for asker in crowd:
        asker.close()


def test_frozen_programs_delay_no_others_stop_and_each_of_them_is_named(frozen, serve, holder):
    hang = [frozen(), frozen()]
    board = serve()
    holder(str(board.link), "m.send('1XM60000;2XM60000'); m.x.jog(1)")
    wait_for(board.driving, "the motor to run")
    run = run_cli("stop")
    assert not board.driving() and run.returncode == 1 and run.stdout.count("stopped (by") == 1
    assert all(f"process {process.pid} " in run.stderr for process in hang) and run.stderr.count("\n") == 1


def test_all_are_asked_at_once(capsys):
    together = threading.Barrier(3)

    def stop() -> str:
        together.wait(PATIENCE_S)  # breaks if one is asked after the other
        return STOPPED

    asked = [StopListener([f"/dev/ttyTEST{i}"], stop) for i in range(3)]
    try:
        assert main.main(["stop"]) == 0
        assert capsys.readouterr().out.count("stopped (by") == 3
    finally:
        for owner in asked:
            owner.close()


def test_a_socket_left_by_a_dead_program_of_the_same_number_is_in_nobodys_way(runtime):
    earlier = StopListener(["/dev/ttyTEST"], lambda: SENT)
    earlier.close()
    names = ["/dev/ttyTEST", "socket://127.0.0.1:1"]
    for name in names:
        path = runtime / f"{stop_socket._key(name)}.{os.getpid()}.{earlier._number + 1}.stop"
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
            dead.bind(str(path))
    owner = StopListener(names, lambda: STOPPED)
    try:
        assert owner.why_not is None
        assert [ask(found) for found in owners("socket://127.0.0.1:1")] == [STOPPED]
    finally:
        owner.close()


@pytest.mark.parametrize("which", ["the same", "another"])
def test_one_that_is_closed_while_a_socket_is_made_anew_leaves_nothing(runtime, monkeypatch, which):
    """The collector of garbage closes that of a forgotten Mount in any thread, so also in one that is in there."""
    monkeypatch.setattr(stop_socket, "_PRESENT_S", 0.01)
    before, closed = set(threading.enumerate()), threading.Event()
    opened = [StopListener([f"/dev/ttyTEST{i}"], lambda: STOPPED) for i in range(2)]
    threads = set(threading.enumerate()) - before
    forgotten = opened.pop(0 if which == "the same" else 1)
    make_folder = stop_socket._make_folder

    def collect() -> Path:
        forgotten.close()
        closed.set()
        return make_folder()

    (owner,) = owners("/dev/ttyTEST0")
    monkeypatch.setattr(stop_socket, "_make_folder", collect)
    owner.path.unlink()
    assert closed.wait(PATIENCE_S)
    opened[0].close()
    for thread in threads:
        thread.join(PATIENCE_S)
    assert not any(thread.is_alive() for thread in threads)
    assert list(runtime.iterdir()) == []
    assert not held_here("/dev/ttyTEST0") and not held_here("/dev/ttyTEST1")


def test_what_is_no_socket_is_left_alone_and_stops_no_stop(runtime):
    owner = StopListener(["/dev/ttyTEST"], lambda: STOPPED)
    try:
        (runtime / "aa.1.1.stop").mkdir()
        (runtime / "bb.1.1.stop").write_text("a file")
        assert [ask(found) for found in owners()] == [STOPPED]
        assert (runtime / "bb.1.1.stop").read_text() == "a file"
    finally:
        owner.close()


@pytest.mark.parametrize("name", ["socket://localhost:1", "socket://127.0.0.1:1/"])
def test_a_served_board_goes_by_each_name_of_this_computer(name):
    owner = StopListener(["socket://127.0.0.1:1"], lambda: STOPPED)
    try:
        assert len(owners(name)) == 1
    finally:
        owner.close()


def test_of_a_program_that_takes_no_stop_none_is_promised(board, holder):
    code = "import serial, sys; s = serial.Serial(sys.argv[1], exclusive=True); print('ready', flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", code, str(board.link)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout.readline() == "ready\n"
        run = run_cli("stop", "--port", str(board.link))
        other.communicate("\n")
    assert run.returncode == 1 and f"process {other.pid} " in run.stderr
    assert "takes no stop" in run.stderr and "goes through it" not in run.stderr


def test_a_folder_that_is_not_this_users_is_said_and_not_used(runtime, tmp_path):
    runtime.symlink_to(tmp_path)
    run = run_cli("stop")
    assert run.returncode == 1 and f"{runtime} belongs to somebody else" in run.stderr
    owner = StopListener(["/dev/ttyTEST"], lambda: SENT)
    owner.close()
    assert owner.why_not == f"{runtime} belongs to somebody else" and list(tmp_path.iterdir()) == []


def test_a_program_that_has_too_many_files_open_takes_stops_again_when_it_has_closed_some(monkeypatch):
    took = threading.Event()
    accept, refused = socket.socket.accept, []

    def accept_later(server):
        if not refused:
            refused.append(server)
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return accept(server)

    def stop() -> str:
        took.set()
        return STOPPED

    monkeypatch.setattr(socket.socket, "accept", accept_later)
    owner = StopListener(["/dev/nothing"], stop)
    try:
        assert ask(owners("/dev/nothing")[0]) == STOPPED
        assert refused and took.is_set()
    finally:
        owner.close()
