"""Programs as clients of a supervised mount, on a live virtual board: control, outcomes, and how motions end."""

import threading

import pytest
from served import PATIENCE_S, ServedBoard, run_process, wait_for
from supervised import sent
from three_axes import make_board_files

from mirrormount.errors import BadValue, BoardError, ConnectionLost, MoveEnded, NotInControl, NotStoppable
from mirrormount.supervise.lease import Client
from mirrormount.supervise.motions import Motion
from mirrormount.supervise.supervisor import Supervisor
from mirrormount.transport import stop_socket
from mountfw import codes as wire


def drives(board):
    wait_for(board.driving, "a motor to run")


def rests(board):
    wait_for(lambda: not board.driving(), "the motors to rest")


def pulses(board, pin):
    """Pulses of an enable that are over."""
    return sum(1 for e in board.edges() if e["pin"] == pin and e["duty"] == 0)


def occupied(supervisor):
    """Keep the mount's thread busy, from now until the event that is returned is set."""
    began, until = threading.Event(), threading.Event()
    supervisor.ask(lambda mount: (began.set(), until.wait(PATIENCE_S)))
    assert began.wait(PATIENCE_S)
    return until


def person(supervisor):
    """A page of a panel that is open on the same mount."""
    page = Client("page 1 (here)", is_person=True)
    supervisor.worker.lease.join(page, object())
    return page


def test_the_outcome_of_steps_is_awaited(loop, board):
    ended = loop.step("x", 3).wait(PATIENCE_S)
    assert (ended.reason, ended.steps) == (wire.DONE, 3)
    assert pulses(board, "m2_en") == 3


def test_motions_of_two_axes_have_an_outcome_each(loop, board):
    motions = [loop.move_to("x", 2), loop.move_to("y", -1)]
    assert [motion.wait(PATIENCE_S).steps for motion in motions] == [2, -1]


def test_a_pulse_has_the_length_that_was_asked_for(loop, board):
    assert loop.pulse("y", -150_000).wait(PATIENCE_S).reason == wire.DONE
    on, off = (e["t_us"] for e in board.edges() if e["pin"] == "m1_en")
    assert off - on == pytest.approx(150_000, abs=100)


def test_a_motion_that_the_board_refuses_says_so_in_its_outcome(loop, board):
    with pytest.raises(BoardError) as e:
        loop.home("x").wait(PATIENCE_S)
    assert e.value.code % 100 == 35  # no switch is fitted
    assert board.edges() == []
    assert loop.in_control


@pytest.mark.parametrize(
    "ask",
    [
        lambda loop: loop.step("z", 1),
        lambda loop: loop.step("x", 1.5),
        lambda loop: loop.move_to("x", 10**7),
        lambda loop: loop.jog("y", 0),
        lambda loop: loop.jog("y", 0.001),
        lambda loop: loop.pulse("y", 199),
        lambda loop: loop.halt("w"),
    ],
)
def test_what_no_mount_could_do_is_refused_at_once(loop, board, ask):
    with pytest.raises(BadValue):
        ask(loop)


def test_without_control_nothing_is_asked_of_the_board(supervisor, loop, board):
    with supervisor.join("scan") as scan:
        with pytest.raises(NotInControl, match="camera loop has control"):
            scan.take_control()
        for ask in (lambda: scan.step("x", 1), lambda: scan.jog("x", 1), lambda: scan.call(lambda m: m.x.zero(5))):
            with pytest.raises(NotInControl):
                ask()
    loop.step("y", 1).wait(PATIENCE_S)
    assert {e["pin"] for e in board.edges()} <= {"m1_pos", "m1_neg", "m1_en"}


def test_when_the_first_leaves_the_second_can_take_control(supervisor, loop, board):
    with supervisor.join("scan") as scan:
        loop.leave()
        scan.take_control()
        assert scan.step("x", 1).wait(PATIENCE_S).steps == 1
        with pytest.raises(NotInControl):
            loop.step("x", 1)
        with pytest.raises(NotInControl, match="has left"):
            loop.take_control()


def test_a_program_that_leaves_stops_what_it_moved(loop, board):
    motion = loop.jog("x", 0.5)
    drives(board)
    loop.leave()
    rests(board)
    with pytest.raises(MoveEnded):
        motion.wait(PATIENCE_S)


@pytest.mark.parametrize("patience_s", [0.35])
def test_a_program_whose_order_comes_while_the_status_is_read_is_stopped_too(supervisor, loop, board):
    """On a busy computer the order is begun in that same poll, whose status says that nothing moves."""
    asked: list[Motion] = []

    def order(_status):
        if not asked:
            loop.beat()
            asked.append(loop.step("x", 1000))

    supervisor.listen(order)
    wait_for(lambda: asked, "the order")
    with pytest.raises(MoveEnded):  # without beats: not by wait()
        asked[0].future.result(PATIENCE_S)
    assert not board.driving()


@pytest.mark.parametrize("patience_s", [0.35])
def test_a_program_that_hangs_is_stopped_and_loses_control(loop, board, told):
    motion = loop.step("x", 1000)
    with pytest.raises(MoveEnded) as e:  # without beats: not by wait()
        motion.future.result(PATIENCE_S)
    assert e.value.reason == wire.ABORTED
    assert not board.driving()
    assert 0 < pulses(board, "m2_en") < 10
    wait_for(lambda: told, "the cause")
    assert "out of touch" in told[0] and "--patience" in told[0] and not loop.in_control


@pytest.mark.wall_clock  # a program that gets no processor for 0.35 s is stopped by design
@pytest.mark.parametrize("patience_s", [0.35])
def test_a_program_that_waits_for_its_motion_is_alive(loop, board):
    assert loop.step("x", 5).wait(PATIENCE_S).steps == 5


def test_a_person_takes_over_and_the_program_is_told(supervisor, loop, board, told):
    motion = loop.jog("x", 0.5)
    drives(board)
    page = person(supervisor)
    supervisor.worker.take_control(page)
    with pytest.raises(MoveEnded):
        motion.wait(PATIENCE_S)
    rests(board)
    assert told == ["page 1 (here) took control"]
    for ask in (loop.take_control, lambda: loop.step("x", 1)):
        with pytest.raises(NotInControl, match="has control"):
            ask()
    supervisor.worker.lease.leave(page, page.connection)
    loop.take_control()
    assert loop.step("y", 1).wait(PATIENCE_S).steps == 1


def test_a_stop_by_anybody_ends_the_motion_and_the_control(supervisor, loop, board, told):
    motion = loop.jog("x", 0.5)
    drives(board)
    supervisor.stop("the test")
    with pytest.raises(MoveEnded) as e:
        motion.wait(PATIENCE_S)
    assert e.value.reason == wire.ABORTED and not board.driving()
    wait_for(lambda: told == ["stopped: the test"], "the cause")
    with pytest.raises(NotInControl):
        loop.step("x", 1)
    loop.take_control()
    assert loop.step("x", 1).wait(PATIENCE_S).steps == 1


def test_a_stop_wins_over_a_request_that_waits(supervisor, loop, board, monkeypatch):
    monkeypatch.setattr("mirrormount.supervise.worker.LATE_S", PATIENCE_S)
    busy = occupied(supervisor)
    motion = loop.step("x", 3)
    supervisor.stop("the test")
    busy.set()
    with pytest.raises(MoveEnded, match="stopped before it began"):
        motion.wait(PATIENCE_S)
    supervisor.ask(lambda mount: mount.status()).result(PATIENCE_S)
    assert board.edges() == []


def test_a_stop_between_two_motions_is_not_lost(supervisor, loop, board):
    """A loop that has asked for nothing at the moment of a STOP does not go on after it."""
    loop.step("x", 1).wait(PATIENCE_S)
    supervisor.stop("the test")
    edges = len(board.edges())
    with pytest.raises(NotInControl, match="after a stop"):
        loop.step("x", 1)
    supervisor.ask(lambda mount: mount.status()).result(PATIENCE_S)
    assert len(board.edges()) == edges


def test_a_program_that_retakes_control_in_an_outcome_has_been_told_of_the_stop(supervisor, loop, board, told):
    motion = loop.jog("x", 0.5)
    drives(board)
    at_outcome = []

    def retake(_future):
        at_outcome.extend(told)
        loop.take_control()

    motion.future.add_done_callback(retake)
    supervisor.stop("the test")
    wait_for(lambda: at_outcome == ["stopped: the test"], "the cause, before the outcome")
    wait_for(lambda: loop.in_control, "control again")


def test_a_program_that_retakes_control_before_the_stop_is_confirmed_is_told_of_it(supervisor, loop, told):
    busy = occupied(supervisor)
    supervisor.stop("the test")
    loop.take_control()
    assert told == ["stopped: the test"]
    busy.set()


@pytest.mark.skipif(not stop_socket.supported(), reason="no Unix sockets")
def test_mirrormount_stop_ends_the_motion_of_a_program(supervisor, loop, board):
    motion = loop.jog("x", 0.5)
    drives(board)
    run = run_process("stop", "--port", str(board.link))
    assert run.returncode == 0, run.stderr
    assert not board.driving()
    with pytest.raises(MoveEnded):
        motion.future.result(PATIENCE_S)
    with pytest.raises(NotInControl):
        loop.step("x", 1)


def test_where_no_stop_gets_in_any_more_nothing_moves(supervisor, loop, board, told):
    supervisor.ask(lambda mount: mount.send("2XM60000")).result()
    motion = loop.jog("x", 1)
    wait_for(board.driving, "the motor to run")
    supervisor.worker.mount.session.stop_listener._server.close()  # its thread ends
    with pytest.raises(MoveEnded, match="aborted"):
        motion.wait()
    assert told == ["stopped: the thread that takes the stops of other programs has ended"]
    edges = len(board.edges())
    loop.take_control()
    with pytest.raises(NotStoppable, match="nothing was done: the thread"):
        loop.step("x", 1).wait()
    assert not board.driving() and len(board.edges()) == edges


def test_halt_ends_a_jog_as_asked_and_keeps_control(loop, board):
    motion = loop.jog("x", 0.5)
    drives(board)
    loop.halt("x").result(PATIENCE_S)
    assert motion.wait(PATIENCE_S).reason == wire.STOPPED
    rests(board)
    assert loop.step("y", 1).wait(PATIENCE_S).steps == 1


def test_a_jog_that_another_one_replaces_is_superseded(loop, board):
    first, second = loop.jog("x", 0.5), loop.jog("x", -0.5)
    with pytest.raises(MoveEnded) as e:
        first.wait(PATIENCE_S)
    assert e.value.reason == wire.SUPERSEDED
    assert not second.done
    loop.halt("x").result(PATIENCE_S)
    second.wait(PATIENCE_S)


def orders(supervisor, *mnemonics):
    """The lines of these commands that have gone to the board."""
    return [line for line in sent(supervisor.worker) if any(mnemonic in line for mnemonic in mnemonics)]


def test_a_new_target_in_mid_move_ends_the_move_and_is_reached(loop, board):
    first = loop.move_to("x", 1000)
    drives(board)
    second = loop.move_to("x", -1)
    with pytest.raises(MoveEnded) as e:
        first.wait(PATIENCE_S)
    assert e.value.reason == wire.SUPERSEDED
    assert second.wait(PATIENCE_S).reason == wire.DONE
    assert loop.call(lambda mount: mount.x.position).result(PATIENCE_S) == -1


def test_of_a_flood_of_targets_and_halts_the_latest_is_carried_out_and_no_halt_is_lost(supervisor, loop, board):
    running = loop.jog("x", 0.5)
    drives(board)
    busy = occupied(supervisor)
    flood = [loop.move_to("x", n) if n % 2 else loop.halt("x") for n in range(1, 2000)]
    busy.set()
    with pytest.raises(MoveEnded, match="superseded"):
        running.wait(PATIENCE_S)
    wait_for(lambda: orders(supervisor, "PA1999"), "the latest target")
    assert not flood[-1].done
    assert len(orders(supervisor, "PA")) == 1 and len(orders(supervisor, "ST")) == 1


def test_a_halt_drops_the_target_that_waits(supervisor, loop, board):
    busy = occupied(supervisor)
    motion = loop.move_to("x", 5)
    halted = loop.halt("x")
    busy.set()
    halted.result(PATIENCE_S)
    with pytest.raises(MoveEnded) as e:
        motion.wait(PATIENCE_S)
    assert e.value.reason == wire.STOPPED
    assert board.edges() == []


def test_a_stop_wins_over_a_target_that_waits_for_the_move_before_it(supervisor, loop, board):
    loop.move_to("x", 1000)
    drives(board)
    second = loop.move_to("x", 2000)
    supervisor.stop("the test")
    with pytest.raises(MoveEnded):
        second.wait(PATIENCE_S)
    rests(board)
    supervisor.ask(lambda mount: mount.status()).result(PATIENCE_S)
    assert len(orders(supervisor, "PA")) == 1 and not board.driving()


def test_a_position_between_two_steps_is_reached_by_parts(loop, board):
    loop.move_to("x", 1.5, parts=True).wait(PATIENCE_S)
    status = loop.call(lambda mount: mount.x.status()).result(PATIENCE_S)
    assert status.position == pytest.approx(1.5, abs=0.001)
    with pytest.raises(BadValue, match="whole"):
        loop.move_to("x", 1.5)


def test_who_listens_knows_the_position_before_the_outcome_is_told(supervisor, loop):
    seen, at_outcome = [], []
    supervisor.listen(seen.append)
    motion = loop.step("x", 2)
    motion.future.add_done_callback(lambda _future: at_outcome.append(seen[-1].x))
    motion.wait(PATIENCE_S)
    wait_for(lambda: at_outcome, "the outcome")
    assert (at_outcome[0].position, at_outcome[0].moving) == (2, False)


def test_who_listens_is_told_that_the_board_has_gone_before_the_outcome(supervisor, loop, board):
    seen, at_outcome = [], []
    supervisor.listen(seen.append)
    motion = loop.jog("x", 0.5)
    drives(board)
    motion.future.add_done_callback(lambda _future: at_outcome.append(seen[-1]))
    board.end()
    wait_for(lambda: at_outcome == [None], "the loss, before the outcome")


def test_the_end_of_a_motion_does_not_wait_for_the_slow_poll(supervisor, loop, monkeypatch):
    monkeypatch.setattr("mirrormount.supervise.worker.POLL_S", 10 * PATIENCE_S)
    assert loop.step("x", 2).wait(PATIENCE_S).steps == 2


@pytest.mark.parametrize("patience_s", [0.35])
def test_a_program_may_have_a_patience_of_its_own(supervisor, loop, board):
    loop.leave()
    with supervisor.join("slow", patience_s=60.0) as slow:
        slow.take_control()
        assert slow.step("x", 6).future.result(PATIENCE_S).steps == 6  # 3 s without a beat


def test_settings_are_read_once_and_again_after_a_change(supervisor, loop):
    read = supervisor.worker.settings
    before = read().result(PATIENCE_S)
    assert before["x"]["soft_maximum"] > 7
    lines = len(sent(supervisor.worker))
    assert read().result(PATIENCE_S) is before and len(sent(supervisor.worker)) == lines
    loop.call(lambda mount: mount.apply({"x": {"soft_maximum": 7}}), changes=True).result(PATIENCE_S)
    assert read().result(PATIENCE_S)["x"]["soft_maximum"] == 7


def test_a_wait_that_is_over_too_early_leaves_the_motion_alone(loop, board):
    motion = loop.jog("x", 0.5)
    with pytest.raises(TimeoutError):
        motion.wait(0.01)
    drives(board)
    assert not motion.done
    loop.halt("x").result(PATIENCE_S)
    motion.wait(PATIENCE_S)


def test_a_board_that_is_unplugged_ends_motion_and_control_and_comes_back_at_rest(supervisor, loop, board, told):
    motion = loop.jog("x", 0.5)
    drives(board)
    folder = board.link.parent
    board.end()
    with pytest.raises(ConnectionLost):
        motion.wait(PATIENCE_S)
    wait_for(lambda: told, "the cause")
    with ServedBoard(folder) as again:
        wait_for(lambda: supervisor.status, "the board to be back")
        with pytest.raises(NotInControl):
            loop.step("x", 1)
        assert again.edges() == []
        loop.take_control()
        assert loop.step("x", 1).wait(PATIENCE_S).steps == 1


def test_a_supervisor_that_is_closed_leaves_nobody_waiting(board):
    supervisor = Supervisor(str(board.link), patience_s=5.0).open()
    loop = supervisor.join("camera loop")
    loop.take_control()
    motion = loop.jog("x", 0.5)
    drives(board)
    supervisor.close()
    assert not board.driving()
    with pytest.raises((ConnectionLost, MoveEnded)):
        motion.wait(PATIENCE_S)
    with pytest.raises(ConnectionLost):
        loop.step("x", 1).wait(PATIENCE_S)


def test_without_a_board_nothing_is_left_running(tmp_path):
    before = threading.active_count()
    with pytest.raises(Exception, match="there is no such port"):
        Supervisor(str(tmp_path / "nothing")).open()
    assert threading.active_count() == before


def test_a_third_axis_is_moved_by_its_name(tmp_path):
    (tmp_path / "files").mkdir()
    with (
        ServedBoard(tmp_path, *make_board_files(tmp_path / "files")) as board,
        Supervisor(str(board.link), patience_s=5.0) as supervisor,
        supervisor.join("camera loop") as loop,
    ):
        assert supervisor.worker.state.axes == ("x", "y", "axis3")
        loop.take_control()
        motions = [loop.step(axis, n) for axis, n in (("x", 1), ("y", -1), ("axis3", 2))]
        assert [motion.wait(PATIENCE_S).steps for motion in motions] == [1, -1, 2]
        wait_for(lambda: supervisor.worker.state.positions[-1][1] == (1.0, -1.0, 2.0), "the three positions")
