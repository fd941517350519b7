"""Each rule of the end-stops, on the bench with switches: a motor that really runs into them."""

import pytest

from mirrormount import errors
from mirrormount.device.mount import Mount
from mirrormount_sim.profiles import SWITCH_REV


@pytest.fixture
def mount():
    with Mount.open("virtual://?speed=max&bench=switches") as mount:
        mount.send("1XL3;2XL3")
        train = bench(mount).horizontal
        train.screw_rev = train.shaft_rev = SWITCH_REV - 0.1  # some steps before the end
        yield mount


def bench(mount: Mount):
    return mount.link.port.simulation.bench


def run_to_the_end(mount: Mount, speed: float = 1.0) -> int:
    mount.x.jog(speed)
    while mount.status().x.moving:
        mount.sleep(0.1)
    return mount.x.wait().reason


def test_a_run_ends_at_the_switch_and_not_at_the_screws_end(mount):
    assert run_to_the_end(mount) == 4
    # from the switch's edge the motor coasts 0.001 revolutions
    assert bench(mount).horizontal.screw_rev == pytest.approx(SWITCH_REV, abs=0.005)
    assert mount.status().x.limits == 1
    assert mount.take_errors() == ["204, AXIS 2 POSITIVE END-STOP REACHED"]


def test_into_the_switch_nothing_drives_and_out_of_it_everything(mount):
    run_to_the_end(mount)
    edges = len(mount.link.port.simulation.edges)
    for into in (lambda: mount.x.step(1), lambda: mount.drive(0, 100)):
        with pytest.raises(errors.BoardError, match="204"):
            into()
    with pytest.raises(errors.BoardError, match="204"):
        mount.x.jog(1)
    assert not [e for e in mount.link.port.simulation.edges[edges:] if e[1] == "m2_en" and e[2]]
    mount.x.step(-8)
    assert mount.status().x.limits == 0
    mount.x.step(1)


def test_the_other_axis_is_not_held(mount):
    run_to_the_end(mount)
    mount.y.step(2)
    with pytest.raises(errors.BoardError):
        mount.drive(255, 255)


def test_a_switch_stays_with_its_electrical_direction_when_the_axis_is_inverted(mount):
    mount.send("2XI1")
    assert run_to_the_end(mount, -1.0) == 4
    assert mount.status().x.limits == 2
    assert bench(mount).horizontal.screw_rev > 0
    assert mount.take_errors() == ["205, AXIS 2 NEGATIVE END-STOP REACHED"]


def test_a_broken_wire_reads_as_an_active_switch(mount):
    bench(mount).broken.add("m1_sw_pos")
    with pytest.raises(errors.BoardError, match="104"):
        mount.y.step(1)
    mount.y.step(-1)


def test_both_switches_active_is_a_fault_until_checking_is_off(mount):
    bench(mount).broken |= {"m1_sw_pos", "m1_sw_neg"}
    for n in (1, -1):
        with pytest.raises(errors.BoardError, match="142"):
            mount.y.step(n)
    mount.send("1ZH1")
    mount.y.step(1)


def test_switches_that_are_not_fitted_are_not_read():
    with Mount.open("virtual://?speed=max&bench=switches") as mount:
        bench(mount).broken |= {"m1_sw_pos", "m1_sw_neg", "m2_sw_pos", "m2_sw_neg"}
        mount.x.step(2)
        mount.y.step(-2)
        assert mount.status().x.limits == 0


def test_a_board_with_nothing_on_its_inputs_cannot_move_towards_a_switch_that_is_called_fitted():
    with Mount.open("virtual://?speed=max") as mount:
        mount.x.step(1)
        mount.send("2XL1")
        with pytest.raises(errors.MoveEnded, match="204"):
            mount.x.step(1)
        mount.x.step(-1)
