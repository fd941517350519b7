"""Who controls, and whose page is alive, with a clock that the test turns."""

import pytest

from mirrormount.supervise.lease import SILENT_S, Desk


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
def desk(clock):
    return Desk(clock)


def entered(desk, where="here"):
    page = desk.add(where)
    desk.enter(page, object())
    return page


def test_the_first_page_controls_and_the_second_does_not(desk):
    first = entered(desk)
    entered(desk)
    assert desk.controller is first


def test_a_page_that_says_the_last_tick_is_alive_and_one_that_is_silent_is_not(desk, clock):
    page = entered(desk)
    for _ in range(10):
        clock.now_s += 0.05
        assert desk.hear(page, desk.tick())
        assert desk.alive(page)
    clock.now_s += SILENT_S + 0.01
    assert not desk.alive(page)


def test_a_page_that_says_an_old_tick_is_not_made_alive_by_it(desk, clock):
    page = entered(desk)
    old = desk.tick()
    clock.now_s += SILENT_S + 0.01
    assert not desk.hear(page, old)
    assert not desk.alive(page)


@pytest.mark.parametrize("tick", [10**390, -(10**390)])
def test_a_tick_of_any_length_is_understood(desk, clock, tick):
    page = entered(desk)
    assert desk.hear(page, tick) == (tick > 0)


@pytest.mark.parametrize("tick", [None, "1000000", True, 1e6, [1], {}])
def test_what_is_no_tick_is_not_fresh(desk, tick):
    assert not desk.hear(entered(desk), tick)


def test_a_tick_of_the_future_keeps_no_page_alive(desk, clock):
    page = entered(desk)
    desk.hear(page, desk.tick() + 3_600_000)
    clock.now_s += SILENT_S + 0.01
    assert not desk.alive(page)


def test_nobody_controls_after_the_page_that_did_has_gone(desk):
    first, second = entered(desk), entered(desk)
    assert desk.leave(first, first.connection)
    assert desk.controller is None
    desk.claim(second)
    assert desk.controller is second


def test_the_end_of_an_older_connection_does_not_make_the_page_go(desk):
    page = desk.add("here")
    old, new = object(), object()
    desk.enter(page, old)
    desk.enter(page, new)
    assert not desk.leave(page, old)
    assert page.connected and desk.controller is page


def test_a_page_that_has_gone_cannot_take_control(desk):
    first, second = entered(desk), entered(desk)
    desk.leave(second, second.connection)
    desk.claim(second)
    assert desk.controller is first


def test_a_page_of_another_run_is_not_known(desk):
    page = entered(desk)
    assert desk.find(page.key) is page
    assert Desk().find(page.key) is None
