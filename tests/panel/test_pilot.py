"""The thread that speaks to the mount, and the brake, without a web: with pages that the test makes."""

import os
import threading
from collections import deque

import pytest
from served import wait_for

from mirrormount.common.errors import ConnectionLost
from mirrormount.supervise.lease import Desk
from mirrormount.supervise.presses import HOLD_S, Hold, Presses
from mirrormount.supervise.requests import Drive, GoTo, Press, Steps
from mirrormount.supervise.worker import Pilot
from mirrormount.transport.serial_port import SerialPort
from mountfw import codes as wire

RIGHT = Press(1, 0, 255, False)


class AlwaysAlive(Desk):
    """A desk whose connected pages are alive without a beat."""

    def alive(self, page) -> bool:
        return page.connected


class Clock:
    """Time in seconds, that passes only when told."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def timed(desk, clock):
    """A pilot for which the time between press and release passes only when told."""
    pilot = Pilot("virtual://", desk, clock)
    pilot.open()
    wait_for(lambda: pilot.status, "the first look at the board")
    yield pilot
    pilot.close()


def looked(pilot) -> None:
    """Wait until the pilot has looked at the board twice."""
    for _ in range(2):
        before = pilot.seen_s
        wait_for(lambda before=before: pilot.seen_s > before, "a look")


def test_a_press_of_0_6_s_is_one_whole_step(timed, page, clock):
    before = len(sent(timed))
    timed.order(page, RIGHT)
    wait_for(lambda: timed.status.x.position == 1, "the step")
    clock.now_s += 0.6
    looked(timed)
    timed.release(page)
    looked(timed)
    assert timed.status.x.position == 1
    assert not any("MV" in line or line == "!" for line in sent(timed)[before:])


def test_a_press_that_is_held_for_longer_is_a_run_until_it_is_let_go(timed, page, clock):
    timed.order(page, RIGHT)
    wait_for(lambda: timed.status.x.position == 1, "the step")
    clock.now_s += HOLD_S
    wait_for(lambda: timed.status.x.position > 1.1, "the run")
    timed.release(page)
    wait_for(lambda: not moving(timed), "the end of the run")
    assert timed.why == "the button was let go"


def tap(pilot, page, press=RIGHT) -> None:
    pilot.order(page, press)
    pilot.release(page)


@pytest.mark.parametrize("how", ["stop", "gone", "refusal"])
def test_presses_that_wait_are_dropped(pilot, page, desk, how):
    for _ in range(5):
        tap(pilot, page, Press(1, 0, 255, True))
    wait_for(lambda: moving(pilot) and len(pilot.presses) == 4, "the first one")
    if how == "stop":
        pilot.stop("the test")
    elif how == "gone":
        pilot.gone(page)
    else:
        pilot.call(lambda mount: mount.link.ask(b"1PR1;2PR1;XS?\n", 1.0)).result(20)  # n14: it moves
    wait_for(lambda: not pilot.presses and not moving(pilot), "rest")
    looked(pilot)
    assert not moving(pilot) and pilot.status.x.position <= 10


def test_a_press_of_a_diagonal_that_one_axis_refuses_stops_the_other(pilot, page):
    pilot.call(lambda mount: mount.apply({"y": {"soft_maximum": 3, "checking": 8}})).result(20)
    tap(pilot, page, Press(1, 1, 255, True))
    wait_for(lambda: page.notices, "the refusal")
    wait_for(lambda: not moving(pilot), "rest")
    looked(pilot)
    assert pilot.status.x.position < 10 and pilot.status.y.position == 0


def test_a_diagonal_run_of_which_the_board_ends_one_axis_does_not_lose_its_release(pilot, page):
    pilot.call(lambda mount: mount.apply({"y": {"soft_maximum": 3, "checking": 8}})).result(20)
    pilot.order(page, Press(1, 1, 255, False))
    wait_for(lambda: any(notice.error == "106" for notice in pilot.notices), "the soft limit of Y")
    pilot.release(page)
    wait_for(lambda: not moving(pilot), "the end of the run")
    assert pilot.status.x.reason == wire.ABORTED  # and not by the run limit


def test_a_release_that_comes_while_its_press_leaves_the_queue_is_not_lost():
    presses = Presses()

    class Queue(deque):
        """Another thread releases the last press at the worst moment."""

        def popleft(self) -> Hold:
            hold = super().popleft()
            if presses.last:
                presses.last.released = True
            return hold

    presses._waiting = Queue()
    presses.add(Hold(Desk().add("here"), RIGHT, 0, 0.0))
    assert presses.next().released


@pytest.fixture
def desk():
    return AlwaysAlive()


@pytest.fixture
def page(desk):
    page = desk.add("here")
    desk.enter(page, object())
    return page


@pytest.fixture
def pilot(desk):
    pilot = Pilot("virtual://", desk)
    pilot.open()
    wait_for(lambda: pilot.status, "the first look at the board")
    yield pilot
    pilot.close()


def sent(pilot) -> list[str]:
    """What went to the board, without the polls."""
    return [entry.text for entry in pilot.log.since(0) if entry.to_board and not entry.poll]


def moving(pilot) -> bool:
    return pilot.status.moving


def test_an_order_that_is_refused_while_a_button_is_held_does_not_lose_its_release(pilot, page):
    pilot.order(page, RIGHT)
    wait_for(lambda: any("MV+" in line for line in sent(pilot)), "the run")
    pilot.order(page, GoTo("x", 1_000_000))
    wait_for(lambda: page.notices, "the refusal")
    pilot.release(page)
    wait_for(lambda: not moving(pilot), "the end of the run")
    assert "!" in sent(pilot)[-4:]


def test_a_step_that_is_refused_does_not_become_a_run(pilot, page):
    pilot.order(page, Steps("x", 20))
    wait_for(lambda: moving(pilot), "the move")
    pilot.order(page, RIGHT)
    wait_for(lambda: page.notices, "the refusal")
    wait_for(lambda: not moving(pilot), "the end of the move")
    assert not any("MV" in line for line in sent(pilot))


def busy(pilot) -> threading.Event:
    """Keep the mount's thread busy until the event that is returned is set."""
    until = threading.Event()
    pilot.call(lambda mount: until.wait(20))
    return until


def test_an_order_that_had_to_wait_for_too_long_is_not_begun(pilot, page, monkeypatch):
    monkeypatch.setattr("mirrormount.supervise.worker.LATE_S", 0.0)
    until = busy(pilot)
    pilot.order(page, Drive(100, 0))
    until.set()
    wait_for(lambda: page.notices, "the refusal")
    assert "busy" in page.notices[0]
    assert not any("100" in line for line in sent(pilot))


def test_who_asks_and_goes_away_does_not_cost_the_board(pilot):
    until = busy(pilot)
    question = pilot.call(lambda mount: mount.status())
    assert question.cancel()
    until.set()
    pilot.call(lambda mount: mount.status()).result(20)
    assert list(pilot.notices) == []


def test_who_asked_when_there_was_no_board_does_not_cost_the_one_that_came(pilot):
    mount, pilot.mount = pilot.mount, None
    question = pilot.call(lambda mount: mount.status())
    pilot.mount = mount
    with pytest.raises(ConnectionLost):
        question.result(20)
    pilot.call(lambda mount: mount.status()).result(20)
    assert pilot.mount is mount
    assert list(pilot.notices) == []


@pytest.mark.skipif(os.name != "posix", reason="a pty needs POSIX")
def test_a_stop_that_meets_a_port_just_closed_by_another_thread_finds_it_gone():
    controller, terminal = os.openpty()
    port = SerialPort(os.ttyname(terminal), 115200)
    fd, port._serial.fd = port._serial.fd, None  # as in the middle of close()
    with pytest.raises(ConnectionLost):
        port.write(b"!\n")
    port._serial.fd = fd
    port.close()
    os.close(controller)
    os.close(terminal)
