"""A motion is kept alive while the program that started it lives, and ends when it falls silent."""

import threading

import pytest
from served import PATIENCE_S

from mirrormount.device.mount import Mount


@pytest.fixture
def mount():
    with Mount.open("virtual://?speed=max") as mount:
        yield mount


def test_keep_alive_is_fed_while_a_program_sleeps(mount):
    mount.x.jog(1)
    mount.sleep(3)
    assert mount.status().x.moving


def test_a_program_that_falls_silent_stops_the_mount(mount):
    mount.x.jog(1)
    mount.link.sleep(3)  # passes time without feeding
    status = mount.status()
    assert not status.moving
    assert status.x.reason == 7
    assert [e.split(",")[0] for e in mount.take_errors()] == ["62"]


def test_the_real_time_board_is_fed_by_itself_while_the_program_does_something_else():
    with Mount.open("virtual://") as mount:
        mount.ask("2XM1500;XK?")
        mount.x.jog(1)
        mount.session.keep_alive.join(PATIENCE_S)  # ends when the motion does: at the run limit, not at the keep-alive
        assert mount.x.wait().reason == 6


def test_a_motion_that_starts_as_the_feeder_ends_is_fed(mount):
    with Mount.open("virtual://") as mount:
        status = mount.session.status
        ending, started = threading.Event(), threading.Event()

        def held() -> object:
            answer = status()
            if threading.current_thread().name == "keep-alive" and not answer.moving and not started.is_set():
                ending.set()
                started.wait(PATIENCE_S)  # the feeder has seen the end of the first motion
            return answer

        mount.session.status = held
        mount.x.step(1, wait=False)
        assert ending.wait(PATIENCE_S)
        mount.send("2XM1500")
        mount.x.jog(1)
        started.set()
        assert mount.x.wait().reason == 6


def test_a_motion_that_send_starts_is_kept_alive_while_the_program_lives(mount):
    assert mount.send("1>2MV+;2MV?") == "1>+"
    mount.sleep(2)
    assert mount.status().x.moving
    mount.link.sleep(1)  # nobody asks the board
    assert mount.status().x.reason == 7


def test_a_line_with_a_keep_alive_of_its_own_is_sent_as_it_is(mount):
    mount.send("XK0;2MV+")
    mount.link.sleep(2)
    assert mount.status().x.moving
    mount.stop()


def test_without_feeding_a_motion_ends_by_its_keep_alive(mount):
    mount.x.jog(1, feed=False)
    mount.link.sleep(1)
    assert mount.status().x.reason == 7
