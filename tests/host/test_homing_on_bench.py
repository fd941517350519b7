"""Homing, soft limits and take-up on the bench: what the client asks for is what the pins and the screw do."""

import pytest

from mirrormount import errors
from mirrormount.device.mount import Mount
from mirrormount.device.status import Limits
from mirrormount_sim.profiles import SWITCH_REV

REV_A_STEP = 0.025  # of the bench's motor, nearly
ALL = 3  # switches


@pytest.fixture
def mount():
    with Mount.open("virtual://?speed=max&bench=switches") as mount:
        mount.apply({"x": {"switches": ALL}, "y": {"switches": ALL}})
        train = bench(mount).horizontal
        train.screw_rev = train.shaft_rev = -SWITCH_REV + 0.2  # some steps before the end
        yield mount


def bench(mount: Mount):
    return mount.link.port.simulation.bench


def driven(mount: Mount) -> bool:
    return any(bench(mount).duties().values())


def near_a_switch(mount: Mount) -> bool:
    return abs(abs(bench(mount).horizontal.screw_rev) - SWITCH_REV) < REV_A_STEP


def test_homing_ends_at_a_switch_with_position_0_and_certainty_homed(mount):
    assert mount.x.home().discrepancy_steps is None
    assert near_a_switch(mount) and not driven(mount)
    status = mount.x.status()
    assert (status.position, status.certainty) == (0, "homed")


@pytest.mark.full
def test_a_second_homing_finds_the_same_place_and_tells_by_how_much_the_count_was_off(mount):
    mount.x.home()
    first = bench(mount).horizontal.screw_rev
    away = 1 if first < 0 else -1
    mount.x.step(10 * away)
    again = mount.x.home()
    assert again.discrepancy_steps == pytest.approx(0, abs=3)
    assert bench(mount).horizontal.screw_rev == pytest.approx(first, abs=REV_A_STEP / 4)


@pytest.mark.parametrize("direction", [1, -1])
def test_an_end_stop_is_found_on_its_own_side(mount, direction):
    mount.x.find_end_stop(direction)
    assert near_a_switch(mount) and not driven(mount)
    assert bench(mount).horizontal.screw_rev * direction > 0


def test_without_a_switch_nothing_moves(mount):
    mount.apply({"x": {"switches": 0}})
    edges = len(mount.link.port.simulation.edges)
    for seek in (mount.x.home, lambda: mount.x.find_end_stop(1)):
        with pytest.raises(errors.BoardError, match="235"):
            seek()
    assert len(mount.link.port.simulation.edges) == edges


def test_a_switch_that_is_never_reached_ends_homing_at_the_search_limit(mount):
    mount.apply({"x": {"search_limit_ms": 500}})
    with pytest.raises(errors.MoveEnded, match="245") as ended:
        mount.x.find_end_stop(1)
    assert ended.value.reason == 12
    assert not driven(mount)


def test_a_move_beyond_a_soft_limit_is_refused_and_a_run_ends_there(mount):
    mount.x.zero()
    mount.x.limits = Limits(-5, 5)
    edges = len(mount.link.port.simulation.edges)
    with pytest.raises(errors.BoardError, match="206"):
        mount.x.step(6)
    with pytest.raises(errors.BoardError, match="207"):
        mount.x.move_to(-6)
    assert len(mount.link.port.simulation.edges) == edges
    mount.x.jog(1)
    assert mount.x.wait().reason == 5
    assert mount.x.position == pytest.approx(5, abs=0.5)
    mount.x.limits = Limits(-5, 5, checked=False)
    mount.x.step(2)


def test_take_up_makes_a_step_after_a_turn_a_step(mount):
    def lost() -> float:
        mount.x.step(6)
        before = bench(mount).horizontal.screw_rev
        mount.x.step(-6)
        turned = bench(mount).horizontal.screw_rev
        mount.x.step(-6)
        return abs(bench(mount).horizontal.screw_rev - turned) - abs(turned - before)

    train = bench(mount).horizontal
    train.screw_rev = train.shaft_rev = 0.0
    without = lost()
    mount.x.take_up_us = round(train.gap_rev / REV_A_STEP * 200_000)
    mount.x.step(6)
    assert abs(lost()) < without / 4
    assert mount.x.position == -6
