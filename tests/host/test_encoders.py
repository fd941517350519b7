"""The bench's encoders: they follow the shafts, to the microsecond, and each machine's hardware counts every edge."""

import random

import pytest
from encoder_reader import Reader

from mirrormount.errors import BadAddress
from mirrormount_sim.bench import Bench, Order
from mirrormount_sim.board import open_virtual
from mirrormount_sim.mechanics import COUNTS_A_REV, NOISE_BITS
from mirrormount_sim.profiles import PROFILES, ROUGH, SMOOTH

LETTERS = (b"f", b"r", b"F", b"R", b"fF", b"rF", b"fR", b"oO", b"o", b"O")


@pytest.fixture
def reader(tmp_path):
    made = []

    def make(machine="cpython", encoder="motor", **options):
        made.append(Reader(tmp_path, machine, encoder, **options))
        return made[-1]

    yield make
    for each in made:
        each.close()


def drive(bench, motor, way, us):
    """Drive for so long, then wait until it stands."""
    bench.edge(bench.us, f"{motor}_{way}", 65535)
    bench.edge(bench.us, f"{motor}_en", 65535)
    bench.advance(bench.us + us)
    bench.edge(bench.us, f"{motor}_en", 0)
    bench.edge(bench.us, f"{motor}_{way}", 0)
    cut_us = bench.us
    bench.advance(bench.us + 300_000)
    return cut_us


def changes(bench, motor="m1"):
    return bench.encoders[motor].between(-1, bench.us)


def test_a_step_is_280_counts_of_the_motor_and_the_last_ones_come_after_the_cut():
    bench = Bench(encoder="motor")
    cut_us = drive(bench, "m1", "pos", 200_000)
    counts = changes(bench)
    assert 270 < counts[-1].counts - counts[0].counts < 290
    late = [change for change in counts if change.us > cut_us]
    assert 5 < len(late) < 20
    assert late[-1].us < cut_us + 50_000


@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)
def test_a_change_is_at_the_microsecond_at_which_the_shaft_passes_it(profile):
    coarse, fine = (Bench(encoder="motor", profile=profile, seed=3) for _ in range(2))
    fine_changes = []
    for way, us in (("pos", 30_000), ("neg", 25_000)):
        fine.edge(fine.us, f"m1_{way}", 65535)
        fine.edge(fine.us, "m1_en", 65535)
        for part in range(us + 40_000):
            if part == us:
                fine.edge(fine.us, "m1_en", 0)
                fine.edge(fine.us, f"m1_{way}", 0)
            before = fine.encoders["m1"].count(fine.trains["m1"])
            fine.trains["m1"].advance(1e-6, fine.drive("m1"))
            fine.us += 1
            fine.encoders["m1"].cut(fine.us)
            after = fine.encoders["m1"].count(fine.trains["m1"])
            if after != before:
                fine_changes.append((fine.us, after))
        coarse.edge(coarse.us, f"m1_{way}", 65535)
        coarse.edge(coarse.us, "m1_en", 65535)
        coarse.advance(coarse.us + us)
        coarse.edge(coarse.us, "m1_en", 0)
        coarse.edge(coarse.us, f"m1_{way}", 0)
        coarse.advance(coarse.us + 40_000)
    found = changes(coarse)[1:]
    assert [count for _, count in fine_changes] == [change.counts for change in found]
    assert all(abs(us - change.us) <= 2 for (us, _), change in zip(fine_changes, found, strict=True))


def test_after_a_reversal_the_motor_turns_first_then_the_shaft_then_the_screw():
    motor, shaft = Bench(encoder="motor"), Bench(encoder="shaft")
    for bench in (motor, shaft):
        drive(bench, "m1", "pos", 500_000)
    begin_us = motor.us
    screw = shaft.trains["m1"].screw_rev
    shaft.edge(shaft.us, "m1_neg", 65535)
    shaft.edge(shaft.us, "m1_en", 65535)
    while shaft.trains["m1"].screw_rev == screw:
        shaft.advance(shaft.us + 1000)
    drive(motor, "m1", "neg", 500_000)
    first_of_motor = next(change for change in changes(motor) if change.us > begin_us)
    first_of_shaft = next(change for change in changes(shaft) if change.us > begin_us)
    assert first_of_motor.us + 50_000 < first_of_shaft.us < shaft.us - 50_000


def test_a_turn_of_the_screw_is_11837_counts_before_the_gears_and_4096_after_them():
    for kind, counts in (("motor", 11837), ("shaft", 4096)):
        bench = Bench(encoder=kind)
        drive(bench, "m1", "pos", 200_000)  # the play is taken up
        train, encoder = bench.trains["m1"], bench.encoders["m1"]
        screw, before = train.screw_rev, encoder.count(train)
        drive(bench, "m1", "pos", 3_000_000)
        assert (encoder.count(train) - before) / (train.screw_rev - screw) == pytest.approx(counts, rel=0.01)
        assert round(COUNTS_A_REV[kind]) == counts


@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)
@pytest.mark.parametrize("machine", ["cpython", "micropython", "circuitpython"])
def test_a_board_counts_every_edge(reader, machine, profile):
    board = reader(machine, profile=profile)
    choose = random.Random(5)
    for _ in range(25):
        board.run(choose.choice(LETTERS), choose.randrange(1000, 150_000))
    board.run(b"oO", 300_000)
    assert board.counted() == board.turned()
    assert all(board.turned())


@pytest.mark.parametrize("machine", ["cpython", "micropython", "circuitpython"])
def test_a_board_reads_the_angle_of_the_shaft(reader, machine):
    board = reader(machine, "shaft")
    board.run(b"fF", 700_000)
    board.run(b"oO", 300_000)
    assert board.counts() == [count % 4096 for count in board.true()]
    assert all(count > 200 for count in board.turned())


def test_what_a_board_counts_does_not_depend_on_how_long_it_waits(reader):
    board = reader()
    board.run(b"f", 1_500_000)  # it waits for its next letter all the time
    board.run(b"o", 300_000)
    assert board.counted() == board.turned()
    assert board.turned()[0] > 2000


def ordered(reader, fault, us=400_000, **options):
    board = reader(orders=[Order(fault, "m1"), Order(fault, "m2")], **options)
    board.run(b"f", us)
    board.run(b"o", 300_000)
    return board.counted()[0], board.turned()[0]


def test_lost_edges_are_counted_too_few(reader):
    counted, turned = ordered(reader, "lost", 2_000_000)
    assert 0.9 * turned < counted < turned


def test_exchanged_wires_count_the_other_way(reader):
    counted, turned = ordered(reader, "swapped")
    assert counted == -turned < -400


def test_wires_that_are_off_count_nothing(reader):
    counted, turned = ordered(reader, "broken")
    assert counted == 0 < turned


def test_noise_is_counted_there_and_back(reader):
    counted, turned = ordered(reader, "noise", 2_000_000)
    assert abs(counted - turned) <= 1


def test_a_jammed_screw_stalls_the_motor_once_its_play_is_taken_up(reader):
    board = reader(orders=[Order("jammed", "m1")])
    board.run(b"f", 500_000)
    here = board.counted()[0]
    board.run(b"", 500_000)
    assert board.counted()[0] == here > 100


def test_a_hand_on_the_knob_is_counted_while_nothing_drives(reader):
    board = reader(orders=[Order("hand", "m2", 1_000_000)])
    board.run(b"", 2_000_000)
    assert board.counted() == board.turned()
    assert board.turned()[0] == 0
    assert board.turned()[1] > 300


def test_a_sensor_that_is_off_does_not_answer_and_noise_moves_it_by_little(reader):
    board = reader(encoder="shaft", orders=[Order("broken", "m1"), Order("noise", "m2")])
    assert board.counts()[0] == -1
    angles = [board.counts()[1] for _ in range(100)]
    assert 0 < max(angles) - min(angles) <= 2 * NOISE_BITS


def test_without_an_encoder_the_bench_moves_as_with_one():
    plain, fitted = Bench(profile=ROUGH, seed=9), Bench(profile=ROUGH, seed=9, encoder="motor")
    for bench in (plain, fitted):
        drive(bench, "m1", "pos", 150_000)
        drive(bench, "m2", "neg", 90_000)
    assert plain.spot_mrad() == pytest.approx(fitted.spot_mrad(), abs=1e-9)
    assert plain.profile is not SMOOTH


@pytest.mark.parametrize(
    "options",
    [
        "encoder=disc",
        "fault=rust",
        "fault=broken@-1",
        "fault=m3:broken",
        "fault=broken@nan",
        "fault=@3",
        "encoder=shaft&fault=noise,m1:lost@3",
        "fault=hand,broken@5",
    ],
)
def test_an_unknown_encoder_or_fault_is_refused_in_one_line(options):
    with pytest.raises(BadAddress, match=r"^[^\n]*(encoder|fault)[^\n]*$"):
        open_virtual(f"virtual://?{options}")
