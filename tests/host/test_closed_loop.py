"""A mount with encoders: a step is its counts, a stall ends, a hand shows, and a position is worth what it says."""

import random

import pytest
from closed_loop import PER_STEP, with_files

from mirrormount import errors
from mirrormount.device.axis import judged
from mirrormount.device.mount import Mount
from mirrormount.device.settings import ENCODER
from mirrormount.transport.link import Link
from mirrormount_sim.demo import closure, square
from mirrormount_sim.table import open_table
from mountfw import codes as wire

STALL_US = 80_000  # from the last count to the pin, of which 60 ms are the setting's


@pytest.mark.parametrize("supply", [0.8, 1.0, 1.2])
@pytest.mark.parametrize("profile", ["smooth", "rough"])
def test_a_step_is_its_counts_whatever_the_supply(loop, profile, supply):
    mount = loop(profile, supply)
    choose = random.Random(3)
    ways = [choose.choice((1, -1)) for _ in range(14)]
    made = [mount.step(way) for way in ways]
    assert all(abs(counts - way * PER_STEP) <= 2 for way, (counts, _) in zip(ways, made, strict=True)), made
    assert mount.mount.x.status().certainty == "measured"
    assert mount.mount.x.position == pytest.approx(sum(ways), abs=2 / PER_STEP)


def test_in_the_open_loop_a_step_follows_the_supply(loop):
    mount = loop("smooth", 0.8, closed=False)
    mount.step(1)
    counts = [mount.step(1)[0] for _ in range(5)]
    assert all(0.75 * PER_STEP < count < 0.82 * PER_STEP for count in counts), counts


def test_a_square_closes_to_a_hundredth_of_a_milliradian(loop):
    mount = loop("smooth")
    play_us = round(mount.bench.trains["m1"].gap_rev * 11836.92 / PER_STEP * 200_000)
    mount.mount.x.take_up_us = mount.mount.y.take_up_us = play_us
    corners, *_ = square(mount.mount)
    assert all(abs(left.measured) <= 0.01 for left in closure(corners)), closure(corners)


@pytest.mark.parametrize(("fault", "reason"), [("jammed", wire.STALLED), ("broken", wire.STALLED)])
@pytest.mark.parametrize("profile", ["smooth", "rough"])
def test_a_motor_that_makes_no_counts_is_off_in_80_ms(loop, profile, fault, reason):
    mount = loop(profile)
    mount.step(1)
    mount.mount.x.step(5, wait=False)
    mount.mount.sleep(0.1)
    assert mount.mount.x.status().moving
    mount.bench.disturb("m2", fault)
    last_us = mount.bench.us
    while mount.bench.drive("m2"):
        before = mount.counts()
        mount.mount.sleep(0.001)
        if fault == "jammed" and mount.counts() != before:
            last_us = mount.bench.us  # what is left of the play
    assert mount.off_us() - last_us <= STALL_US
    mount.mount.sleep(0.2)
    ended = mount.mount.x.last_move()
    assert ended.reason == reason
    assert [error.code for error in mount.mount.errors()] == [200 + wire.AXIS_STALLED]


def test_wires_that_are_exchanged_end_a_move_at_once_and_say_so(loop):
    mount = loop()
    mount.bench.disturb("m2", "swapped")
    with pytest.raises(errors.MoveEnded) as failed:
        mount.mount.x.step(1)
    assert failed.value.codes == (200 + wire.AXIS_WRONG_WAY,)
    assert abs(mount.counts()) < 20_000 and mount.bench.drive("m2") is None


def test_an_edge_that_was_lost_makes_the_position_an_estimate(loop):
    mount = loop()
    mount.step(1)
    assert mount.mount.x.status().certainty == "measured"
    mount.bench.disturb("m2", "lost")
    mount.step(2)
    assert mount.mount.x.status().certainty == "estimated"


def test_the_position_follows_a_hand_on_the_knob(loop):
    mount = loop()
    mount.step(2)  # the play is taken up
    before = mount.counts()
    mount.bench.disturb("m2", "hand")
    mount.mount.sleep(2)
    turned = mount.counts() - before
    assert turned > 100
    assert mount.mount.x.position == pytest.approx(2 + turned / PER_STEP, abs=3 / PER_STEP)
    assert mount.mount.x.status().certainty == "measured"


@pytest.mark.parametrize("encoder", ["motor", "shaft"])
def test_a_host_finds_out_how_the_encoder_counts(loop, encoder):
    mount = loop(closed=False, encoder=encoder)
    per_step = mount.mount.x.measure_counts().per_step
    assert per_step == pytest.approx({"motor": 277, "shaft": 96}[encoder], rel=0.02)
    mount.mount.x.inverted = 1
    assert mount.mount.x.measure_counts().per_step == pytest.approx(per_step, abs=3)
    mount.bench.disturb("m2", "swapped")
    assert mount.mount.x.measure_counts().per_step == pytest.approx(-per_step, abs=3)
    assert mount.mount.x.counts_per_step == 0  # it only measures


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_a_loop_is_closed_again_where_the_encoder_fails_while_it_is_measured(steps):
    with Mount.open("virtual://?speed=max&encoder=shaft&fault=m2:broken@4") as mount:
        mount.apply({"x": {"counts_per_step": 97, "closed_loop": 1}})
        mount.sleep(steps * 0.5)  # the sensor fails in the approach, among the counted steps, after a look
        with pytest.raises(errors.EncoderFault, match="does not answer"):
            mount.x.measure_counts(3)
        assert mount.x.closed_loop == 1


@pytest.mark.parametrize("supply", [0.8, 1.2])
def test_an_encoder_behind_the_gears_is_told_by_its_play_and_closes_the_loop(loop, supply):
    mount = loop("rough", supply, closed=False, encoder="shaft")
    found = mount.mount.x.measure_counts()
    assert found.lost > 30
    mount.mount.apply({"x": found.settings})
    ways = (1, 1, 1, -1, -1, -1, 1, -1)
    made = [mount.step(way)[0] * way for way in ways]
    assert all(abs(counts - found.per_step) <= 2 * mount.mount.x.dead_band for counts in made), made
    assert loop(closed=False).mount.x.measure_counts().lost < 0.3 * PER_STEP


@pytest.mark.parametrize(("profile", "supply", "seed"), [("smooth", 1.2, 2), ("rough", 1.2, 2), ("rough", 0.8, 1)])
def test_the_first_steps_behind_the_gears_end_although_no_coast_is_known(loop, profile, supply, seed):
    mount = loop(profile, supply, closed=False, encoder="shaft", seed=seed)
    per_step = mount.mount.x.measure_counts().per_step
    mount.mount.apply({"x": {"counts_per_step": per_step, "closed_loop": 1}})
    for n in (-1, 1):
        mount.mount.x.step(n)  # raises what the board says
    for n in (1, -1, -1, 1):
        assert mount.step(n)[0] == pytest.approx(n * per_step, abs=0.05 * per_step)


def test_play_of_gears_is_no_stall_after_moves_that_were_not_watched_and_at_low_speed(loop):
    mount = loop("smooth", closed=False, encoder="shaft")
    settings = mount.mount.x.measure_counts().settings
    mount.mount.apply({"x": settings})
    mount.mount.x.step(2)
    mount.mount.x.closed_loop = 0
    mount.mount.x.step(-2)
    mount.mount.x.closed_loop = 1
    mount.mount.x.step(1)  # raises what the board says
    mount.mount.x.jog(-0.3)
    mount.mount.sleep(1)
    assert mount.mount.status().x.moving
    mount.mount.stop()
    mount.bench.disturb("m2", "hand")
    mount.mount.sleep(2)
    mount.mount.x.step(1)
    mount.mount.x.step(-1)


@pytest.mark.parametrize("supply", [0.8, 1.2])
def test_a_run_after_a_reversal_follows_though_the_play_was_over_early(loop, supply):
    mount = loop("smooth", supply, closed=False, encoder="shaft")
    mount.mount.apply({"x": mount.mount.x.measure_counts().settings})
    mount.mount.x.step(3)
    mount.mount.x.jog(-1)
    mount.mount.sleep(1.5)
    assert mount.mount.status().x.moving
    mount.mount.stop()


def test_noise_of_an_angle_in_the_play_of_gears_is_no_stall(loop):
    mount = loop("rough", 0.8, closed=False, encoder="shaft")
    mount.mount.apply({"x": mount.mount.x.measure_counts().settings})
    mount.bench.disturb("m2", "noise")
    for n in (3, -3, 2, -2):
        mount.mount.x.step(n)  # raises what the board says


def test_an_encoder_that_counts_nothing_or_nonsense_is_told_in_one_line(loop):
    mount = loop(closed=False)
    mount.bench.disturb("m2", "broken")
    with pytest.raises(errors.EncoderFault, match=r"^x: the encoder counts nothing"):
        mount.mount.x.measure_counts()
    with pytest.raises(errors.EncoderFault, match="the same way"):
        judged("x", 280.0, -279.0)
    with pytest.raises(errors.EncoderFault, match="much more"):
        judged("x", 280.0, 100.0)


def test_without_an_encoder_there_are_no_counts_and_no_settings_of_one(loop):
    mount = loop(closed=False, encoder=None).mount
    assert not mount.x.has_encoder
    assert "counts_per_step" not in mount.settings()["x"]
    with pytest.raises(errors.NotSupported, match="x has no encoder"):
        _ = mount.x.counts
    with pytest.raises(errors.SettingRefused):
        mount.apply({"x": {"counts_per_step": 280}})
    mount.apply({"x": {"counts_per_step": 0}})  # as a file from such a board says
    assert not mount.errors()


POWER_CUTS = [("cpython", "motor", PER_STEP), ("micropython", "motor", PER_STEP), ("micropython", "shaft", 96)]


@pytest.mark.parametrize(("machine", "encoder", "per_step"), POWER_CUTS)
def test_a_position_after_a_power_cut_is_worth_no_more_than_it_is(tmp_path, machine, encoder, per_step):
    mount = with_files(tmp_path, profile="rough", machine=machine, encoder=encoder, closed=False)
    mount.close_loop(per_step)
    mount.mount.apply({"x": {"dead_band": 4}} if encoder == "shaft" else {})
    mount.mount.save()
    choose = random.Random(11)
    origin = mount.counts()
    known = 0
    for _ in range(8):
        mount.mount.x.step(choose.choice((3, -3)), wait=False)
        mount.mount.sleep(choose.choice((0.05, 0.3, 0.9, 3, 14)) * choose.uniform(0.8, 1.2))
        mount.switch_off_and_on()
        mount.mount.sleep(0.3)  # what turned has come to rest
        status = mount.mount.x.status()
        if status.certainty in ("counted", "homed", "measured"):
            known += 1
            assert status.position == pytest.approx((mount.counts() - origin) / per_step, abs=0.1)
        else:
            mount.mount.x.zero()
            origin = mount.counts()
    mount.close()
    assert 0 < known < 8


OTHER = {
    "counts_per_step": -280,
    "closed_loop": 1,
    "dead_band": 5,
    "correction_s": 0.1,
    "following_error": 100,
    "stall_ms": 200,
    "stall_duty": 120,
    "zero_angle": 4096,
}


def test_the_settings_of_an_encoder_can_be_changed_and_saved(loop):
    mount = loop(closed=False).mount
    assert list(OTHER) == list(ENCODER)
    mount.apply({"x": OTHER})
    mount.save()
    mount.recall(factory=True)
    assert mount.x.closed_loop == 0
    mount.recall()
    assert {name: mount.settings()["x"][name] for name in OTHER} == OTHER
    assert mount.x.dead_band == 5 and mount.x.correction_s == 0.1


def test_a_mount_of_the_virtual_table_has_encoders_if_it_is_told_so():
    with open_table("virtual-table://?encoder=motor&profile=rough&supply=0.8") as table:
        mounts = [Mount(Link(port)) for port in table.ports]
        for mount in mounts:
            mount.apply({"x": {"counts_per_step": PER_STEP, "closed_loop": 1}})
        for mount, simulation in zip(mounts, table.simulations, strict=True):
            encoder, train = simulation.bench.encoders["m2"], simulation.bench.trains["m2"]
            for way in (1, 1, -1):
                before = encoder.count(train)
                mount.x.step(way)
                table.sleep(0.15)
                assert abs(encoder.count(train) - before - way * PER_STEP) <= 2


def test_a_loop_cannot_be_closed_before_the_counts_of_a_step_are_known(loop):
    mount = loop(closed=False).mount
    with pytest.raises(errors.BadValue, match=r"x.counts_per_step, which `mirrormount setup` measures"):
        mount.x.closed_loop = 1
    mount.apply({"x": {"closed_loop": 1, "counts_per_step": 280}})
    with pytest.raises(errors.BadValue, match="counts_per_step"):
        mount.apply({"y": {"closed_loop": 1}})
