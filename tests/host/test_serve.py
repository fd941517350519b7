"""`mirrormount serve`: a virtual board served on TCP; what its pins do when clients come, go and misbehave."""

import os
import pty
import resource
import signal
import socket
from types import SimpleNamespace

import pytest
from served import ServedBoard, run_cli, wait_for
from serving import GREETING, RUN, Cable, Served, ask, hear, hear_line, rests, runs

from mirrormount import errors
from mirrormount import serve as server
from mirrormount.device.mount import Mount
from mirrormount.device.session import Session
from mirrormount.transport import stop_socket

# a client's motion lasts while `serve` feeds the board's keep-alive of 0.5 s: on a busy computer it ends, by design
FLOOD = b"1XM60000;2XM60000\n" + b"02550255\n" * 10_000 + b"00010255\n" + b"02550255\n" * 10_000


def saw_the_middle_of_the_flood(board: ServedBoard) -> bool:
    return any(e["pin"] == "m1_en" and 0 < e["duty"] < 65535 for e in board.edges())


def test_a_client_is_greeted_as_a_new_focus_controller_does_and_answered(served):
    serve = served()
    client = serve.connect()
    assert hear(client, 6) == GREETING
    assert ask(client, b"*IDN?").decode() == serve.identity
    assert ask(client, b"1>VE?").startswith(b"1>MM2 Version ")


def test_motion_through_it_drives_the_pins(served, board):
    client = served().connect()
    hear(client, 6)
    client.sendall(b"1PR-1\n")
    wait_for(lambda: len(board.edges()) == 4, "the step to end")
    assert [e["pin"] for e in board.edges()] == ["m1_neg", "m1_en", "m1_en", "m1_neg"]
    assert ask(client, b"1TP?") == b"-1"


def test_a_mount_can_be_opened_through_it(served, board):
    serve = served()
    with Mount.open(serve.tcp) as mount:
        mount.x.step(2)
        assert mount.x.position == 2
        with pytest.raises(errors.PortBusy):
            Mount.open(serve.tcp)
    with Mount.open(serve.tcp) as mount:
        assert mount.x.position == 2


def test_a_second_client_is_told_and_may_only_stop(served, board):
    serve = served()
    first = serve.drive(RUN)
    runs(board)
    second = serve.connect(b"2MV+\n")
    assert hear(second, 1000) == b"mirrormount: this board has a client already\r\n"
    assert ask(first, b"1MV?;2MV?") == b"+; 0" and board.driving()
    second.sendall(b"0000")
    second.sendall(b"0000")
    rests(board)
    assert ask(first, b"1MV?;1XE?").startswith(b"0; 3,")


@pytest.mark.parametrize("how", ["closed", "reset", "half a message"])
def test_when_the_client_goes_what_it_started_stops(served, board, how):
    client = served().connect(RUN)
    runs(board)
    if how == "reset":
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
    elif how == "half a message":
        client.sendall(b"2PR")
    client.close()
    rests(board)


def test_a_client_gone_behind_a_flood_of_frames_stops_the_motors_with_it(served, board):
    serve = served()
    client = serve.drive(FLOOD)
    runs(board)
    client.close()
    serve.says("has gone: motors stopped")
    rests(board)
    assert ask(serve.drive(), b"1MD?;2MD?") == b"1; 1"
    assert not board.driving() and not saw_the_middle_of_the_flood(board)


def test_a_stop_overtakes_a_flood_of_frames(served, board):
    client = served().drive(FLOOD)
    runs(board)
    client.sendall(b"!\n2DH7;2DH?\n")
    rests(board)
    while hear_line(client) != b"7\r\n":  # the echoes of frames obeyed before
        pass
    assert not board.driving() and not saw_the_middle_of_the_flood(board)


# while motor 1 rests between two of its steps motor 2 drives: both are off only when it has ended
STEPS = b"1XP2000000;2XP1500000;1PR60;2PR60\n"


@pytest.mark.parametrize("motion", [b"1XM60000;1MV+\n", STEPS, b"1XM60000;2XM60000\n02550255", b"XK60000;1MV+\n"])
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_server_that_dies_or_hangs_is_ended_by_the_boards_keep_alive(served, board, motion, how):
    serve = served()
    serve.connect(motion)
    runs(board)
    serve.process.send_signal(how)
    rests(board)
    serve.process.kill()
    serve.process.wait()
    assert_ended_by_the_keep_alive(board)


@pytest.mark.skipif(not hasattr(resource, "prlimit"), reason="Linux limits another process")
@pytest.mark.parametrize("options", [(), ("--on-leave", "finish")])
def test_a_server_without_a_file_for_a_stop_ends_what_moves(served, board, options):
    serve = served(*options)
    client = serve.drive(STEPS)
    runs(board)
    most = resource.prlimit(serve.process.pid, resource.RLIMIT_NOFILE)[1]
    resource.prlimit(serve.process.pid, resource.RLIMIT_NOFILE, (3, most))
    rests(board)
    serve.says("no file is left for the stop of another program")
    assert not hear_line(client)
    resource.prlimit(serve.process.pid, resource.RLIMIT_NOFILE, (most, most))
    assert ask(serve.drive(), b"1MD?;2MD?") == b"1; 1"


def opened(board: ServedBoard) -> Mount | None:
    """None if the board has not answered in time: a busy computer may keep it waiting."""
    try:
        return Mount.open(str(board.link))
    except errors.NotAMount:
        return None


def assert_ended_by_the_keep_alive(board: ServedBoard) -> None:
    mount = wait_for(lambda: opened(board), "the board to answer")
    assert isinstance(mount, Mount)
    with mount:
        assert not mount.status().moving
        assert mount.y.status().reason == 7


def test_a_client_without_a_keep_alive_is_not_cut_short_by_the_servers(served, board):
    client = served().drive(b"1XM1500;1MV+\n")
    wait_for(lambda: len(board.edges()) == 4, "the run limit to end it")
    assert abs(board.off_after_us("m1_en") - 1_500_000) < 5_000
    assert ask(client, b"1XE?").startswith(b"6,")


def test_a_clients_own_keep_alive_is_its_own(served, board):
    client = served().drive(b"1XM60000;XK1200;1MV+\n")
    runs(board)
    wait_for(lambda: not board.driving(), "the client's keep-alive to end it")
    assert ask(client, b"1XE?").startswith(b"7,")
    assert ask(client, b"TE?;XK?") == b"62; 0"


def test_a_client_that_connects_commands_and_closes_moves_where_that_is_wanted(served, board):
    serve = served("--on-leave", "finish")
    serve.drive(b"1PR4;1DH\n").close()  # the second command is refused: it moves
    for _ in range(3):
        asks = serve.drive()
        assert ask(asks, b"1PR?") == b"4"
        asks.close()
    asks = serve.drive()
    wait_for(lambda: ask(asks, b"1MD?") == b"1", "the move to be done")
    assert ask(asks, b"1TP?;1XE?").startswith(b"4; 1,")
    assert len([e for e in board.edges() if e["pin"] == "m1_en" and e["duty"]]) == 4


@pytest.mark.parametrize("motion", [b"1XM60000;1MV+\n", b"1XM60000;2XM60000\n02550255"])
def test_runs_and_frames_end_with_their_client_where_moves_are_finished(served, board, motion):
    client = served("--on-leave", "finish").connect(motion)
    runs(board)
    client.close()
    rests(board)


def test_a_move_that_is_finished_ends_with_the_server(served, board):
    serve = served("--on-leave", "finish")
    serve.drive(STEPS).close()
    serve.says("its move is finished")
    runs(board)
    serve.process.kill()
    rests(board)
    assert_ended_by_the_keep_alive(board)


def test_a_move_that_is_finished_can_be_stopped_by_the_next_client(served, board):
    serve = served("--on-leave", "finish")
    serve.drive(b"1PR60\n").close()
    serve.says("its move is finished")
    runs(board)
    client = serve.drive(b"!\n")
    wait_for(lambda: ask(client, b"1MD?") == b"1", "the stop")
    assert ask(client, b"1XE?").startswith(b"3,")


def test_a_reply_that_comes_back_from_a_client_drives_nothing(served, board):
    """As from a terminal in its default mode between the client and the server, across a slow network."""
    serve = served()
    client = serve.drive(b"02550000")
    reply = hear(client, len(b"#\r\n02550000\r\n255\r\n0\r\n255\r\n0\r\n"))
    client.sendall(b"!\n")
    rests(board)
    stopped_ms = uptime_ms(client)
    wait_for(lambda: uptime_ms(client) - stopped_ms > 200, "200 ms of the board's time")
    client.sendall(reply)
    client.close()
    serve.says("has gone")
    ask(serve.drive(), b"TB?")
    assert [e["duty"] for e in board.edges() if e["pin"] == "m1_en"] == [65535, 0]


def uptime_ms(client: socket.socket) -> int:
    return int(ask(client, b"XS?").split(b",")[1])


def test_another_program_stops_what_a_client_of_the_server_drives(served, board):
    serve = served()
    serve.connect(RUN + b"2PR3\n")
    runs(board)
    run = run_cli("stop", "--port", serve.tcp)
    assert not board.driving()
    assert (run.returncode, run.stdout[:11]) == (0, "stopped (by")
    assert run_cli("stop", "--port", str(board.link)).stdout.startswith("stopped (by")


def test_the_next_client_sees_no_answer_that_was_meant_for_the_last(served):
    serve = served()
    serve.drive(b"*IDN?\n" * 300 + b"02550255\n" * 100).close()
    serve.says("has gone")
    assert ask(serve.drive(), b"2DH41;2DH?") == b"41"


def test_the_next_client_does_not_inherit_a_keep_alive(served):
    serve = served()
    first = serve.drive()
    assert ask(first, b"XK5000;XK?") == b"5000"
    first.close()
    assert ask(serve.drive(), b"XK?") == b"0"


def test_ctrl_c_from_the_network_is_a_stop_and_leaves_the_firmware_running(served, board):
    client = served().drive(RUN)
    runs(board)
    client.sendall(b"\x03\n")
    rests(board)
    assert ask(client, b"\x01\x02\x04\x05\x181XE?").startswith(b"3,")


def test_a_board_unplugged_and_back_is_served_again_at_rest(served, board):
    serve = served()
    client = serve.drive(RUN)
    runs(board)
    board.end()  # takes the port's name away, too, as unplugging does
    assert hear(client, 1) == b""
    serve.says("waiting for the board")
    assert hear_line(serve.connect()) == b"mirrormount: the board is not there\r\n"
    with ServedBoard(board.link.parent) as again:
        serve.says("the board is back")
        assert ask(serve.drive(), b"1MV?") == b"0"
        assert again.edges() == []


@pytest.mark.skipif(not hasattr(socket, "TCP_QUICKACK"), reason="acknowledging at once is Linux's")
def test_a_stop_right_behind_a_command_is_not_held_back_for_want_of_an_acknowledgement(served, board):
    client = served().connect(b"1XM60000\n")
    assert hear(client, 6) == GREETING
    for _ in range(20):  # from the first ones on, what comes is acknowledged at once anyway
        ask(client, b"1TP?")
    lengths_us = []
    for _ in range(5):
        client.sendall(b"1MV+\n")
        runs(board)
        client.sendall(b"!\n")
        rests(board)
        lengths_us.append(board.off_after_us("m1_en"))
        ask(client, b"1TP?")
    assert min(lengths_us) < 30_000  # 40 ms, each time, if it is held back


def test_at_the_boards_prompt_nothing_from_the_network_is_obeyed(board, tmp_path):
    with Cable(board) as cable:
        served = Served(tmp_path, cable.address)
        try:
            client = served.drive()
            assert ask(client, b"1MD?") == b"1"
            cable.console.write(b"\x03")
            served.says("at its Python prompt")
            while client.recv(1000):  # until it is closed
                pass
            assert hear_line(served.connect(b"print(6*7)\n")) == b"mirrormount: the board is not there\r\n"
        finally:
            served.clear_up()


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, 0), (signal.SIGINT, 130), (signal.SIGHUP, 0)])
def test_ending_the_server_stops_the_motors_first(served, board, number, status):
    ignored = signal.signal(number, signal.SIG_DFL)  # under nohup a child would ignore it, and rightly
    serve = served()
    signal.signal(number, ignored)
    client = serve.connect(RUN)
    runs(board)
    assert serve.end(number) == status
    rests(board)
    assert hear(client, 1000) == GREETING
    assert "Traceback" not in serve.log.read_text()
    with Mount.open(str(board.link)) as mount:
        assert mount.y.status().reason == 3


def test_a_board_that_comes_back_at_another_device_is_stopped_by_its_name_and_not_by_its_old_one(served, board):
    serve, device, folder = served(), os.path.realpath(board.link), board.link.parent
    assert stop_socket.owners(device)
    board.end()
    serve.says("waiting for the board")
    assert not stop_socket.owners(device)
    taken = [pty.openpty() for _ in range(4)]  # the old number is another terminal's meanwhile
    with ServedBoard(folder) as again:
        serve.says("the board is back")
        assert os.path.realpath(again.link) != device
        assert not stop_socket.owners(device)
        serve.drive(RUN)
        runs(again)
        assert run_cli("stop", "--port", os.path.realpath(again.link)).stdout.startswith("stopped (by")
        rests(again)
    for terminal in taken:
        os.close(terminal[0])
        os.close(terminal[1])


def test_rests_of_answers_that_come_behind_the_last_stop_are_not_taken_for_its_confirmation():
    session = Session.open("virtual://?speed=max")
    session.send("1MV+")
    port, rests = session.link.port, [b"77\n", b"1,0|3,"]  # the last one is cut: it is a line with what follows it

    def read(timeout_s: float) -> bytes:
        data = port.read(timeout_s)
        return rests.pop(0) + data if rests and data else data

    session.link.port = SimpleNamespace(write=port.write, read=read, close=port.close)
    server._stop(session)
    assert not rests
    assert not session.status().moving
    session.close()


def test_a_stop_is_confirmed_also_where_each_answer_comes_in_two_parts():
    session = Session.open("virtual://?speed=max")
    session.send("1MV+")
    port, late = session.link.port, bytearray()

    def read(timeout_s: float) -> bytes:
        if late:
            data = bytes(late) if timeout_s >= 0.15 else b""
            late[len(late) - len(data) :] = b""
            return data
        data, bar, late[:] = port.read(timeout_s).partition(b"|")
        return data + bar

    session.link.port = SimpleNamespace(write=port.write, read=read, close=port.close)
    session.link.write(b"XS?\n")  # for a client
    server._stop(session)
    assert not session.status().moving
    session.close()


def test_a_burst_of_connections_keeps_no_stop_waiting_for_the_second_attempt_of_its_system():
    with server.listen("127.0.0.1", 0, []) as listening:
        for _ in range(100):  # nobody accepts; what finds no room tries again after 1 s
            socket.create_connection(listening.getsockname(), 0.9).close()
