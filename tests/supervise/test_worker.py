"""The worker on a live virtual board, with clients that the test makes."""

import threading

import pytest
from served import PATIENCE_S, wait_for
from supervised import Clock, at_work, moving, polled, sent
from transcript import second_pair

from mirrormount.device.mount import Mount
from mirrormount.errors import ConnectionLost, NoBoardFound, NotSupported
from mirrormount.supervise.connection import State
from mirrormount.supervise.motions import Asked, start
from mirrormount.supervise.requests import Drive, GoTo, Press, Steps
from mirrormount.supervise.worker import HOLD_S, Worker
from mirrormount.transport.ports import Port, open_port
from mountfw import codes as wire

RIGHT = Press({"x": 1}, 255)


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def timed(lease, clock):
    """A worker for which the time between press and release passes only when told."""
    with at_work(lease, clock) as worker:
        yield worker


def test_a_press_of_0_6_s_is_one_whole_step(timed, page, clock):
    before = len(sent(timed))
    timed.request(page, RIGHT)
    wait_for(lambda: timed.state.status.x.position == 1, "the step")
    clock.now_s += 0.6
    polled(timed)
    timed.release(page)
    polled(timed)
    assert timed.state.status.x.position == 1
    assert not any("MV" in line or line == "!" for line in sent(timed)[before:])


def test_a_press_that_is_held_for_longer_is_a_run_until_it_is_let_go(timed, page, clock):
    timed.request(page, RIGHT)
    wait_for(lambda: timed.state.status.x.position == 1, "the step")
    clock.now_s += HOLD_S
    wait_for(lambda: timed.state.status.x.position > 1.1, "the run")
    timed.release(page)
    wait_for(lambda: not moving(timed), "the end of the run")
    assert timed.stop_cause == "the button was let go"


def tap(worker, page, press=RIGHT) -> None:
    worker.request(page, press)
    worker.release(page)


@pytest.mark.parametrize("how", ["stop", "gone", "refusal"])
def test_presses_that_wait_are_dropped(worker, page, lease, how):
    for _ in range(5):
        tap(worker, page, Press({"x": 1}, 255, steps=10))
    wait_for(lambda: moving(worker) and len(worker.presses) == 4, "the first one")
    if how == "stop":
        worker.stop("the test")
    elif how == "gone":
        worker.client_left(page)
    else:
        worker.call(lambda mount: mount.link.ask(b"1PR1;2PR1;XS?\n", PATIENCE_S)).result(PATIENCE_S)  # n14: it moves
    wait_for(lambda: not worker.presses and not moving(worker), "rest")
    polled(worker)
    assert not moving(worker) and worker.state.status.x.position <= 10


def test_a_press_of_a_diagonal_that_one_axis_refuses_stops_the_other(worker, page):
    worker.call(lambda mount: mount.apply({"y": {"soft_maximum": 3, "checking": 8}})).result(PATIENCE_S)
    tap(worker, page, Press({"x": 1, "y": 1}, 255, steps=10))
    wait_for(lambda: page.notices, "the refusal")
    wait_for(lambda: not moving(worker), "rest")
    polled(worker)
    assert worker.state.status.x.position < 10 and worker.state.status.y.position == 0


def test_a_diagonal_run_of_which_the_board_ends_one_axis_does_not_lose_its_release(worker, page):
    worker.call(lambda mount: mount.apply({"y": {"soft_maximum": 3, "checking": 8}})).result(PATIENCE_S)
    worker.request(page, Press({"x": 1, "y": 1}, 255))
    wait_for(lambda: any(notice.error == "106" for notice in worker.notices), "the soft limit of Y")
    worker.release(page)
    wait_for(lambda: not moving(worker), "the end of the run")
    assert worker.state.status.x.reason == wire.ABORTED  # and not by the run limit


@pytest.fixture
def worker(lease):
    with at_work(lease) as worker:
        yield worker


def test_of_an_axis_that_was_aborted_the_cause_stays_whatever_stops_another_one(worker, page):
    for axis, cause in (("y", "the first stop"), ("x", "the second stop")):
        worker.request(page, Steps(axis, 1000))
        wait_for(lambda axis=axis: worker.state.status.by_name[axis].moving, "the steps")
        worker.stop(cause)
        wait_for(lambda: not moving(worker), "rest")
        polled(worker)
    worker.stop("a stop at rest")
    polled(worker)
    assert worker.state.stopped_by == {"x": "the second stop", "y": "the first stop"}
    worker.request(page, Steps("y", 1))
    wait_for(lambda: worker.state.status.y.reason == wire.DONE, "the step")
    assert worker.state.stopped_by == {"x": "the second stop"}


def test_a_page_that_leaves_in_mid_motion_is_one_stop_with_one_cause(worker, page, lease):
    worker.request(page, Steps("x", 1000))
    wait_for(lambda: moving(worker), "the steps")
    lease.leave(page, page.connection)
    polled(worker)  # whoever sees it first, the worker or the page's own end
    worker.client_left(page)
    polled(worker)
    assert not moving(worker)
    assert [notice.text for notice in worker.notices if notice.text.startswith("stopped")] == [
        "stopped: page 1 (here), which had asked for the motion, has gone"
    ]


def test_a_request_that_is_refused_while_a_button_is_held_does_not_lose_its_release(worker, page):
    worker.request(page, RIGHT)
    wait_for(lambda: any("MV+" in line for line in sent(worker)), "the run")
    worker.request(page, GoTo("x", 1_000_000))
    wait_for(lambda: page.notices, "the refusal")
    worker.release(page)
    wait_for(lambda: not moving(worker), "the end of the run")
    assert "!" in sent(worker)[-4:]


def test_a_step_that_is_refused_does_not_become_a_run(worker, page):
    worker.request(page, Steps("x", 20))
    wait_for(lambda: moving(worker), "the move")
    worker.request(page, RIGHT)
    wait_for(lambda: page.notices, "the refusal")
    wait_for(lambda: not moving(worker), "the end of the move")
    assert not any("MV" in line for line in sent(worker))


def busy(worker) -> threading.Event:
    """Keep the mount's thread busy, from now until the event that is returned is set."""
    began, until = threading.Event(), threading.Event()
    worker.call(lambda mount: (began.set(), until.wait(PATIENCE_S)))
    assert began.wait(PATIENCE_S)
    return until


def test_a_request_that_had_to_wait_for_too_long_is_not_begun(worker, page, monkeypatch):
    monkeypatch.setattr("mirrormount.supervise.worker.LATE_S", 0.0)
    until = busy(worker)
    worker.request(page, Drive(100, 0))
    until.set()
    wait_for(lambda: page.notices, "the refusal")
    assert "busy" in page.notices[0]
    assert not any("100" in line for line in sent(worker))


def test_who_asks_and_goes_away_does_not_cost_the_board(worker):
    until = busy(worker)
    question = worker.call(lambda mount: mount.status())
    assert question.cancel()
    until.set()
    worker.call(lambda mount: mount.status()).result(PATIENCE_S)
    assert list(worker.notices) == []


def test_who_asked_when_there_was_no_board_does_not_cost_the_one_that_came(worker):
    until = busy(worker)  # else it may see that there is no board, and open one
    mount, worker.connection.mount = worker.mount, None
    question = worker.call(lambda mount: mount.status())
    worker.connection.mount = mount
    until.set()
    with pytest.raises(ConnectionLost):
        question.result(PATIENCE_S)
    worker.call(lambda mount: mount.status()).result(PATIENCE_S)
    assert worker.mount is mount
    assert list(worker.notices) == []


def test_a_drive_of_axes_3_and_4_is_refused_as_not_supported_and_is_no_fault(page):
    mount = second_pair()
    with pytest.raises(NotSupported, match="motors 1 and 2"):
        start(mount, Asked(page, Drive(100, 0), 0, 0.0), State())
    mount.close()


def test_a_board_that_is_opened_only_after_the_close_is_closed_again(board, lease, monkeypatch):
    opening, closed = threading.Event(), threading.Event()

    def late() -> Port:
        if threading.current_thread() is not worker._thread:
            raise NoBoardFound("not yet")
        opening.set()
        closed.wait(PATIENCE_S)
        return open_port(str(board.link))

    worker = Worker(late, lease)
    worker.open(absent=True)
    assert opening.wait(PATIENCE_S)
    with monkeypatch.context() as patch:
        patch.setattr(worker._thread, "join", lambda _s: None)  # it needs longer than close() waits
        worker.close()
    closed.set()
    worker._thread.join(PATIENCE_S)
    assert worker.mount is None
    Mount.open(str(board.link)).close()
