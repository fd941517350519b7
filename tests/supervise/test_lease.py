"""Which client has control and which is alive, with a clock that the test turns."""

import pytest
from supervised import Clock

from mirrormount.errors import NotInControl
from mirrormount.supervise.lease import Client, Lease
from mirrormount.values import PATIENCE_S


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def lease(clock):
    return Lease(clock)


def joined(lease, name="page", *, is_person=True):
    client = Client(name, is_person)
    lease.join(client, object())
    return client


def program(lease, name="loop"):
    return joined(lease, name, is_person=False)


def test_the_first_page_controls_and_the_second_does_not(lease):
    first = joined(lease)
    joined(lease)
    assert lease.holder is first


def test_a_page_that_returns_the_last_tick_is_alive_and_one_that_is_silent_is_not(lease, clock):
    page = joined(lease)
    for _ in range(10):
        clock.now_s += 0.05
        assert lease.receive(page, lease.tick())
        assert lease.alive(page)
    clock.now_s += PATIENCE_S + 0.01
    assert not lease.alive(page)


def test_a_page_that_returns_an_old_tick_is_not_made_alive_by_it(lease, clock):
    page = joined(lease)
    old = lease.tick()
    clock.now_s += PATIENCE_S + 0.01
    assert not lease.receive(page, old)
    assert not lease.alive(page)


@pytest.mark.parametrize("tick", [10**390, -(10**390)])
def test_a_tick_of_any_length_is_understood(lease, clock, tick):
    page = joined(lease)
    assert lease.receive(page, tick) == (tick > 0)


@pytest.mark.parametrize("tick", [None, "1000000", True, 1e6, [1], {}])
def test_what_is_no_tick_is_not_fresh(lease, tick):
    assert not lease.receive(joined(lease), tick)


def test_a_tick_of_the_future_keeps_no_page_alive(lease, clock):
    page = joined(lease)
    lease.receive(page, lease.tick() + 3_600_000)
    clock.now_s += PATIENCE_S + 0.01
    assert not lease.alive(page)


def test_nobody_has_control_after_the_client_that_had_it_has_left(lease):
    first, second = joined(lease), joined(lease)
    assert lease.leave(first, first.connection)
    assert lease.holder is None
    lease.claim(second)
    assert lease.holder is second


def test_the_end_of_an_older_connection_does_not_make_the_client_leave(lease):
    page = Client("page", is_person=True)
    old, new = object(), object()
    lease.join(page, old)
    lease.join(page, new)
    assert not lease.leave(page, old)
    assert page.connected and lease.holder is page and lease.clients == (page,)


def test_a_client_that_has_left_cannot_take_control(lease):
    first, second = joined(lease), joined(lease)
    lease.leave(second, second.connection)
    with pytest.raises(NotInControl, match="has left"):
        lease.claim(second)
    assert lease.holder is first


def test_a_program_that_joins_has_no_control_until_it_claims_it(lease):
    loop = program(lease)
    assert lease.holder is None
    with pytest.raises(NotInControl):
        lease.check(loop)
    assert not lease.claim(loop)
    lease.check(loop)


def test_a_person_takes_control_from_a_program_and_a_program_from_no_person_and_no_live_program(lease, clock):
    loop, other = program(lease), program(lease, "other")
    lease.claim(loop)
    page = joined(lease)
    with pytest.raises(NotInControl, match="loop has control"):
        lease.claim(other)
    assert lease.claim(page)
    clock.now_s += PATIENCE_S + 0.01
    with pytest.raises(NotInControl, match="page has control"):
        lease.claim(loop)


def test_a_program_takes_control_from_one_that_hangs(lease, clock):
    loop, other = program(lease), program(lease, "other")
    lease.claim(loop)
    clock.now_s += PATIENCE_S + 0.01
    lease.beat(other)
    assert lease.claim(other)
    with pytest.raises(NotInControl):
        lease.check(loop)


def test_a_claim_from_another_counts_as_a_stop(lease):
    loop = program(lease)
    lease.claim(loop)
    page = joined(lease)
    before = lease.stops
    assert lease.claim(page) and lease.stops == before + 1
    assert not lease.claim(page) and lease.stops == before + 1


def test_a_stop_ends_the_control_of_a_program_and_not_of_a_person(lease):
    loop = program(lease)
    lease.claim(loop)
    lease.stops += 1
    with pytest.raises(NotInControl, match="after a stop"):
        lease.check(loop)
    lease.claim(loop)
    lease.check(loop)
    page = joined(lease)
    lease.claim(page)
    lease.stops += 1
    lease.check(page)


def test_who_loses_control_is_told_once_and_why(lease):
    told = []
    loop = program(lease)
    loop.lost_control = told.append
    lease.claim(loop)
    page = joined(lease)
    lease.end_stopped("no stop came")
    lease.stops += 1
    lease.end_stopped("stopped: the test")
    lease.end_stopped("stopped: the test")
    assert told == ["stopped: the test"]
    lease.claim(loop)
    lease.claim(page)
    assert told == ["stopped: the test", "page took control"]
