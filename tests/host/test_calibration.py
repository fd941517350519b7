"""Angles: only by a scale that somebody measured for that axis, that direction and that step."""

from itertools import pairwise

import pytest

from mirrormount import errors
from mirrormount.cli import main
from mirrormount.device import calibration
from mirrormount.device.calibration import Scale, Step
from mirrormount.device.mount import Mount

USUAL = Step(pulse_us=200_000, step_duty=255)


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "settings"))


@pytest.fixture
def mount():
    with Mount.open("virtual://?speed=max") as mount:
        yield mount


@pytest.fixture
def unmeasured(mount, monkeypatch):
    """The same as a real mount is: its port brings no scale."""
    monkeypatch.setattr(mount.link.port.simulation, "scale", lambda *_: None)
    return mount


def pulses(mount: Mount, pin: str) -> int:
    edges = [duty for _, name, duty in mount.link.port.simulation.edges if name == pin]
    return sum(1 for on, off in pairwise(edges) if on and not off)


def test_an_angle_is_that_many_pulses_of_its_own_direction(mount):
    calibration.write(mount.board_id, {2: Scale(0.2, 0.25, USUAL)})
    assert mount.x.move_by(1.0, "mrad") == pytest.approx(1.0)
    assert pulses(mount, "m2_pos") == 5
    assert mount.x.move_by(-1000, "urad") == pytest.approx(-1000)
    assert pulses(mount, "m2_neg") == 4
    assert mount.x.position == 1


def pulse_lengths_us(mount: Mount, pin: str) -> list[int]:
    edges = [(at_us, duty) for at_us, name, duty in mount.link.port.simulation.edges if name == pin]
    return [off[0] - on[0] for on, off in pairwise(edges) if on[1] and not off[1]]


def test_a_part_of_a_step_is_a_pulse_of_its_own_length_and_an_estimate(mount):
    calibration.write(mount.board_id, {2: Scale(0.2, 0.25, USUAL)})
    mount.x.zero()
    assert mount.x.status().certainty == "counted"
    assert mount.x.move_by(0.5, "mrad") == pytest.approx(0.5)
    assert pulse_lengths_us(mount, "m2_pos") == pytest.approx([200_000, 200_000, 100_000], abs=100)
    assert mount.x.status().position == 2.5
    assert mount.x.status().certainty == "estimated"


def test_a_number_of_steps_between_two_needs_no_scale(mount):
    assert mount.y.move_by(-1.25) == -1.25
    assert pulse_lengths_us(mount, "m1_neg") == pytest.approx([200_000, 50_000], abs=100)


def test_the_amount_is_rounded_to_the_boards_shortest_pulse_and_that_is_returned(mount):
    calibration.write(mount.board_id, {2: Scale(0.2, 0.25, USUAL)})
    assert mount.x.move_by(200.1, "urad") == pytest.approx(200.0)  # 0.1 urad would be 100 us
    assert mount.x.move_by(-250.5, "urad") == pytest.approx(-250.5)
    assert pulses(mount, "m2_pos") == 1 and pulses(mount, "m2_neg") == 2
    with pytest.raises(errors.BadValue, match=r"the least that can be moved, 0\.2 urad"):
        mount.x.move_by(0.1, "urad")


def test_without_waiting_it_is_the_nearest_whole_number_of_steps(mount):
    calibration.write(mount.board_id, {2: Scale(0.2, 0.25, USUAL)})
    assert mount.x.move_by(0.5, "mrad", wait=False) == pytest.approx(0.4)
    mount.x.wait()
    assert pulses(mount, "m2_pos") == 2
    for amount, unit in ((1.5, "steps"), (0.05, "mrad")):
        with pytest.raises(errors.BadValue):
            mount.x.move_by(amount, unit, wait=False)


def test_a_position_in_an_angle_goes_by_the_mean_of_both_directions(unmeasured):
    mount = unmeasured
    calibration.write(mount.board_id, {2: Scale(0.2, 0.3, USUAL)})
    mount.x.zero()
    assert mount.x.move_to(500, "urad") == 2
    assert mount.x.move_to(0.3, "mrad", wait=False) == 1  # 1.2 steps
    mount.x.wait()
    assert mount.x.position == 1
    assert mount.x.move_to(-0.375, "mrad") == -1.5
    assert pulse_lengths_us(mount, "m2_neg") == pytest.approx([200_000] * 3 + [100_000], abs=100)
    for position, unit in ((float("nan"), "mrad"), (1e9, "mrad"), (1, "parsec")):
        with pytest.raises(errors.BadValue):
            mount.x.move_to(position, unit)
    with pytest.raises(errors.NotCalibrated):
        mount.y.move_to(1, "mrad")
    assert mount.x.position == -1.5


def test_the_command_moves_to_a_position_in_an_angle_and_says_where_it_is(capsys):
    with Mount.open("virtual://?speed=max") as mount:
        calibration.write(mount.board_id, {2: Scale(0.2, 0.3, USUAL)})
    assert main.main(["move", "x", "0.5", "mrad", "--port", "virtual://?speed=max"]) == 0
    assert capsys.readouterr().out == "x: moved +2 steps, now at +2 (unknown, ≈ +0.5 mrad)\n"


@pytest.mark.parametrize("profile", ["smooth", "hardware"])
@pytest.mark.parametrize(("name", "mirror"), [("x", 0), ("y", 1)])
def test_a_fresh_virtual_mount_turns_its_mirror_by_the_angle_that_was_asked_for(profile, name, mirror):
    with Mount.open(f"virtual://?speed=max&profile={profile}") as mount:
        axis, bench = mount.axis(name), mount.link.port.simulation.bench
        for way in (1, -1):
            axis.step(way * 10)  # closes the gap
            before = bench.mirrors_rad()[0][mirror]
            assert axis.move_by(way * 3000, "urad") == pytest.approx(way * 3000, abs=1)
            assert (bench.mirrors_rad()[0][mirror] - before) * 1e6 == pytest.approx(way * 3000, rel=0.1)


def test_a_virtual_mounts_own_scale_is_of_full_duty_only(mount):
    mount.send("2XD200")
    with pytest.raises(errors.NotCalibrated):
        mount.x.move_by(1, "mrad")


def test_the_commands_say_that_the_scale_is_the_virtual_mounts(capsys):
    assert main.main(["step", "x", "100", "urad", "--port", "virtual://?speed=max"]) == 0
    assert capsys.readouterr().out.startswith("x: moved +0.465 steps (≈ +100 urad, by the virtual mount's own scale), ")
    assert main.main(["move", "y", "1", "mrad", "--port", "virtual://?speed=max"]) == 0
    assert capsys.readouterr().out.endswith(" mrad, by the virtual mount's own scale)\n")


def test_an_angle_of_the_beam_and_mm_on_the_screen_follow_from_the_mirrors(mount):
    calibration.write(mount.board_id, {1: Scale(0.2, 0.25, USUAL, 1.5, 2000.0)})
    assert mount.y.move_by(0.6, "beam-mrad") == pytest.approx(0.6)
    assert mount.y.move_by(300, "beam-urad") == pytest.approx(300)
    assert pulses(mount, "m1_pos") == 3
    assert mount.y.move_by(-1.5, "mm") == pytest.approx(-1.5)  # a step back: 0.25 mrad x 1.5 x 2 m = 0.75 mm
    assert pulses(mount, "m1_neg") == 2


@pytest.mark.parametrize(
    ("scale", "unit", "missing"),
    [
        (Scale(0.2, 0.2, USUAL), "beam-mrad", "beam_per_mirror"),
        (Scale(0.2, 0.2, USUAL), "mm", "beam_per_mirror"),
        (Scale(0.2, 0.2, USUAL, 2.0), "mm", "screen_mm"),
    ],
)
def test_a_unit_whose_geometry_is_not_known_is_refused(mount, scale, unit, missing):
    calibration.write(mount.board_id, {2: scale})
    with pytest.raises(errors.NotCalibrated, match=missing):
        mount.x.move_by(1, unit)
    assert not pulses(mount, "m2_en")


def test_a_pulse_has_the_length_that_was_asked_for_and_its_bounds(mount):
    mount.x.pulse(12_000)
    mount.x.pulse(-2_000_000)
    assert pulse_lengths_us(mount, "m2_pos") == pytest.approx([12_000], abs=100)
    assert pulse_lengths_us(mount, "m2_neg") == pytest.approx([2_000_000], abs=100)
    for us in (0, 199, -199, 2_000_001, 300.5, True):
        with pytest.raises(errors.BadValue):
            mount.x.pulse(us)
    assert pulses(mount, "m2_en") == 2


def test_steps_need_no_scale(mount):
    assert mount.x.move_by(2) == 2
    assert pulses(mount, "m2_pos") == 2


def test_an_angle_without_a_scale_is_refused_with_the_remedy_and_nothing_moves(unmeasured):
    mount = unmeasured
    with pytest.raises(errors.NotCalibrated) as refusal:
        mount.y.move_by(0.5, "mrad")
    for part in ("mirrormount setup", str(calibration.path()), f"[{mount.board_id}.axis1]", "positive"):
        assert part in str(refusal.value)
    assert not pulses(mount, "m1_en")


def test_a_scale_is_for_its_direction_axis_and_board_only(unmeasured):
    mount = unmeasured
    calibration.write(mount.board_id, {2: Scale(0.2, None, USUAL)})
    calibration.write("another", {1: Scale(0.2, 0.2, USUAL)})
    for axis, angle in ((mount.x, -1), (mount.y, 1)):
        with pytest.raises(errors.NotCalibrated):
            axis.move_by(angle, "mrad")
    mount.x.move_by(1, "mrad")


@pytest.mark.parametrize("line", ["2XP100000", "2XD128", "2XI1"])
def test_a_scale_of_another_step_is_refused(mount, line):
    calibration.write(mount.board_id, {2: Scale(0.2, 0.2, USUAL)})
    mount.send(line)
    with pytest.raises(errors.NotCalibrated, match="200000 us at duty 255"):
        mount.x.move_by(1, "mrad")
    assert not pulses(mount, "m2_en")


@pytest.mark.parametrize(
    ("amount", "unit"),
    [("1", "mrad"), (True, "mrad"), (float("nan"), "mrad"), (1, "degrees"), (0.00005, "mrad"), (0.0001, "steps")],
)
def test_an_amount_that_is_none_is_refused(mount, amount, unit):
    calibration.write(mount.board_id, {2: Scale(0.2, 0.2, USUAL)})
    with pytest.raises(errors.BadValue):
        mount.x.move_by(amount, unit)
    assert not pulses(mount, "m2_en")


def test_what_is_written_is_read_again_and_other_boards_stay():
    calibration.write("a1", {1: Scale(0.21, 0.22, USUAL, 2.0, 1500.0), 2: Scale(None, 0.3, Step(1000, 7, 1))})
    path = calibration.write("b.2 ", {1: Scale(1e-7, 1, USUAL)})
    assert calibration.read("a1", 1) == Scale(0.21, 0.22, USUAL, 2.0, 1500.0)
    assert calibration.read("a1", 2) == Scale(None, 0.3, Step(1000, 7, 1))
    assert calibration.read("b.2 ", 1) == Scale(1e-7, 1, USUAL)
    assert calibration.read("a2", 1) is None
    assert [file.name for file in path.parent.iterdir()] == ["calibration.toml"]


def test_a_file_that_a_person_wrote_is_taken():
    calibration.path().parent.mkdir()
    calibration.path().write_text(
        "[e661.axis2] # mine\npositive = 1\nnegative = 0.5\npulse_us = 200_000\nstep_duty = 255\n"
    )
    assert calibration.read("e661", 2) == Scale(1, 0.5, USUAL)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[a1.axis1]\npositive = = 1", "line 2"),
        ("[a1.axis1]\npositive = 0", "pulse_us"),
        ("[a1.axis1]\npulse_us = 200000\nstep_duty = 255\npositive = -1", "positive is a number above 0"),
        ("[a1.axis1]\npulse_us = 200000\nstep_duty = 255\npositive = inf", "positive"),
        ("[a1.axis1]\npulse_us = 200000\nstep_duty = 255\npositive = 1e-320", "positive"),  # 1 mrad: inf steps
        ("[a1.axis1]\npulse_us = 200000\nstep_duty = 255\npositive = 1" + "0" * 400, "too long"),  # no float
        ("[a1.axis1]\npulse_us = 200000\nstep_duty = true", "step_duty"),
        ("[a1]\naxis1 = 3", "not a table"),
        ("a1 = 3", "not a table"),
    ],
)
def test_a_damaged_file_is_one_line_with_its_place_and_stays_as_it_is(text, says):
    calibration.path().parent.mkdir()
    calibration.path().write_text(text)
    with pytest.raises(errors.BadFile, match=says) as damage:
        calibration.read("a1", 1)
    assert str(calibration.path()) in str(damage.value) and "\n" not in str(damage.value)
    assert calibration.path().read_text() == text


def test_a_file_that_is_no_toml_is_not_written_over():
    calibration.path().parent.mkdir()
    calibration.path().write_bytes(b"\xff\xfe")
    with pytest.raises(errors.BadFile):
        calibration.write("a1", {1: Scale(0.2, 0.2, USUAL)})
    assert calibration.path().read_bytes() == b"\xff\xfe"


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "file"))
    with pytest.raises(errors.MountError) as refusal:
        calibration.write("a1", {1: Scale(0.2, 0.2, USUAL)})
    assert "\n" not in str(refusal.value)
