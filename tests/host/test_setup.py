"""`mirrormount setup` with a person who looks at the virtual screen and presses virtual switches."""

import math

import pytest
from setup_person import Person, set_up
from three_axes import make_firmware, switch_on

from mirrormount import errors
from mirrormount.cli.setup import Dialogue, run_course
from mirrormount.device import calibration
from mirrormount.device.calibration import Marks, beam_per_mirror, measure_scale
from mirrormount.device.mount import Mount
from mirrormount.transport.link import Link
from mirrormount_sim.bench import SCREEN_MM

pytestmark = pytest.mark.usefixtures("own_folder")


def mirror_mrad(train) -> float:
    return train.mirror_rad * 1e3


def test_the_scale_that_setup_finds_is_that_of_the_mirror(mount):
    set_up(mount, {"Steps from": [""]}, distance_mm=SCREEN_MM)
    for axis, train in ((mount.x, "horizontal"), (mount.y, "vertical")):
        scale = calibration.read(mount.board_id, axis.number)
        mirror = getattr(mount.link.port.simulation.bench, train)
        axis.step(5)
        before = mirror_mrad(mirror)
        axis.step(20)
        assert scale.positive == pytest.approx((mirror_mrad(mirror) - before) / 20, rel=0.02)
        axis.step(-5)
        before = mirror_mrad(mirror)
        axis.step(-20)
        assert scale.negative == pytest.approx((before - mirror_mrad(mirror)) / 20, rel=0.02)


@pytest.mark.full
def test_the_take_up_that_setup_finds_closes_the_gap_of_a_turn(mount):
    train = mount.link.port.simulation.bench.horizontal

    def lost_in_a_turn() -> float:
        mount.x.step(8)
        marks = [train.screw_rev]
        for _ in range(2):
            mount.x.step(-8)
            marks.append(train.screw_rev)
        return abs(marks[2] - marks[1]) - abs(marks[1] - marks[0])

    before = lost_in_a_turn()
    set_up(mount, distance_mm=SCREEN_MM)
    assert abs(lost_in_a_turn()) < before / 4


@pytest.mark.full
def test_a_take_up_beyond_what_the_board_takes_up_is_told_with_what_was_measured(mount):
    def mm(steps: float) -> str:  # of 0.2 mrad of the mirror
        return f"{SCREEN_MM * math.tan(2 * 0.2e-3 * steps):.4f}"

    lost = 14
    marks = [mm(0), mm(40), mm(lost), mm(lost - 40), mm(0)]
    person = set_up(mount, {"(more is right)": marks, "Steps from": ["40"]}, distance_mm=SCREEN_MM)
    assert mount.settings()["x"]["take_up_us"] == 2_000_000
    told = "take-up 2000000 us (a turn loses 2.8 s of drive, and the board takes up 2 s at most)"
    assert any(told in text for text in person.said)


def test_what_setup_has_found_is_kept_through_a_recall(mount):
    set_up(mount, {"End-stop switches on y": ["none"]}, distance_mm=SCREEN_MM)
    found = mount.settings()
    assert found["x"]["take_up_us"] > 100_000
    assert (found["x"]["switches"], found["y"]["switches"]) == (3, 0)
    mount.recall(factory=True)
    assert mount.settings()["x"]["take_up_us"] == 0
    mount.recall()
    assert mount.settings() == found


def test_an_axis_that_goes_the_wrong_way_is_inverted_and_looked_at_again(mount):
    mount.apply({"y": {"inverted": 1}})
    person = set_up(mount)
    assert mount.settings()["y"]["inverted"] == 0
    assert sum("Which way" in question for question in person.asked) == 3
    before = mount.link.port.simulation.bench.spot_mm()[1]
    mount.y.step(5)
    assert mount.link.port.simulation.bench.spot_mm()[1] > before + 5


def test_exchanged_motors_are_told_with_what_to_do(mount):
    with pytest.raises(errors.SetupEnded, match=r"exchange their plugs.*nothing was saved"):
        set_up(mount, {"Which way": ["up"]})
    assert not calibration.path().exists()


def test_an_axis_that_never_moves_the_spot_ends_setup_after_three_tries(mount):
    edges = mount.link.port.simulation.edges
    with pytest.raises(errors.SetupEnded, match="motor supply"):
        set_up(mount, {"Which way": ["nothing"] * 3})
    assert len([e for e in edges if e[1] == "m2_en" and e[2]]) == 5 + 10 + 20


def test_switches_whose_wires_are_exchanged_are_told(mount):
    person = set_up(mount, wires_swapped=True)
    assert any("exchange the two switches' wires" in text for text in person.said)
    assert mount.settings()["x"]["switches"] == 3


def test_a_switch_that_is_never_seen_is_not_called_fitted(mount):
    set_up(mount, {"Press the right": ["skip"]})
    assert mount.settings()["x"]["switches"] == 2


def test_a_switch_on_an_inverted_axis_is_fitted_at_the_input_that_it_is_on(mount):
    train = mount.link.port.simulation.bench.horizontal
    train.lever_mm = -train.lever_mm  # the screw pushes from the other side: positive is left
    set_up(mount, {"End-stop switches on x": ["left"], "Press the left": [""] * 3 + ["skip"]})
    assert mount.settings()["x"]["inverted"] == 1
    assert mount.settings()["x"]["switches"] == 0  # nothing was pressed


def test_wrong_answers_are_asked_again(mount):
    person = set_up(
        mount,
        {"May it move": ["", "perhaps"], "Distance": ["far", "-1", "nan"], "Which way": ["sideways", ""]},
        distance_mm=SCREEN_MM,
    )
    assert sum("Distance" in question for question in person.asked) == 4
    assert mount.settings()["x"]["take_up_us"] > 0


@pytest.fixture
def mount_of_three(tmp_path):
    make_firmware(tmp_path)
    with Mount(Link(switch_on(tmp_path))) as mount:
        yield mount


def third_steps(mount: Mount) -> int:
    return sum(duty > 0 for _, pin, duty in mount.link.port.simulation.edges if pin == "m3_en")


def test_an_axis_that_turns_no_mirror_gets_its_direction_and_switches_and_no_scale(mount_of_three):
    answers = {
        "How does axis3": ["neither"],
        "Which way did axis3 go": ["nothing", "backward", "again", "forward"],
        "End-stop switches on axis3": ["forward"],
        "End-stop switches": ["none"] * 2,
    }
    person = set_up(mount_of_three, answers)
    assert not any(answers.values())
    assert third_steps(mount_of_three) == 5 + 10 + 10 + 10
    third = mount_of_three.settings()["axis3"]
    assert (third["inverted"], third["switches"]) == (1, 0)  # its board file has no input for that switch
    assert not any("axis3's" in question or "mirror of axis3" in question for question in person.asked)
    assert person.said[-2] == "The settings are saved on the board."


def test_an_axis_of_a_second_mirror_gets_a_scale_by_its_own_distance(mount_of_three):
    answers = {
        "How does axis3": ["vertically"],
        "Distance from the mirror of axis3": ["1000"],
        "Angle": ["0"],
        "End-stop switches": ["none"] * 3,
    }
    person = Person(mount_of_three, answers)
    place = iter(["0", "16", "3.2", "-12.8", "0"])  # marks of 8 steps of 1 mrad of the mirror, 1.6 steps of backlash

    def answer(question: str) -> str:
        if "Where is the spot" in question:
            return next(place)
        if "Which way" in question and "axis3: 5 steps up …" in person.said[-2:]:
            return "up"
        return person(question)

    run_course(mount_of_three, answer, person.say)
    scale = calibration.read(mount_of_three.board_id, 3)
    assert scale.positive == pytest.approx(1.0, rel=1e-3) and scale.negative == pytest.approx(1.0, rel=1e-3)
    assert calibration.read(mount_of_three.board_id, mount_of_three.x.number) is None
    assert mount_of_three.settings()["axis3"]["take_up_us"] == pytest.approx(1.6 * 200_000, rel=0.01)


@pytest.mark.full
def test_readings_that_go_the_wrong_way_are_taken_again(mount):
    person = set_up(mount, {"(more is right)": ["0", "-26", "-20", "10", "0"]}, distance_mm=SCREEN_MM)
    assert any("must grow to the right" in text for text in person.said)
    assert calibration.read(mount.board_id, mount.x.number) is not None


def test_the_arithmetic_gives_back_what_made_the_marks():
    n, mrad, lost, distance = 20, 0.2, 1.5, 5000.0

    def mm(steps: float) -> float:
        return distance * math.tan(2 * mrad * 1e-3 * steps)

    found = measure_scale(Marks(0, mm(n), mm(lost), mm(lost - n), mm(0)), n, distance, beam_per_mirror("x", 45))
    assert found.positive == pytest.approx(mrad)
    assert found.negative == pytest.approx(mrad, rel=1e-4)
    assert found.lost == pytest.approx((lost, lost), abs=1e-3)


def test_a_folding_mirror_turns_the_beam_less_when_it_tips():
    assert beam_per_mirror("y", 45) == pytest.approx(math.sqrt(2))
    assert beam_per_mirror("x", 45) == beam_per_mirror("y", 0) == 2


def test_every_number_is_repeated_with_its_unit(mount):
    person = set_up(mount, {"Distance": ["5000"], "Angle": ["45.5"]}, distance_mm=SCREEN_MM)
    assert {"  = 5000 mm", "  = 45.5 degrees", "  = 8 steps"} <= set(person.said)


@pytest.mark.parametrize(
    ("typed", "replies", "means"),
    [("7,62", ["yes"], "7.62"), ("7,620", ["yes"], "7.620"), ("7,620", ["no", "yes"], "7620"), ("1,2,3", [], None)],
)
def test_what_a_comma_means_is_asked(typed, replies, means):
    asked, said = [], []
    answers = iter([typed, *replies, "1"])

    def answer(question):
        asked.append(question)
        return next(answers)

    value = Dialogue(answer, said.append).number("How far, in mm?", "mm", 0, 1e6)
    assert value == (1.0 if means is None else float(means))
    assert sum("A comma" in question for question in asked) == len(replies)
    assert said[-1] == f"  = {value:.10g} mm"


def test_no_number_is_rounded_to_whole_steps_in_silence():
    said = []
    answers = iter(["7.5", "8"])
    assert Dialogue(lambda question: next(answers), said.append).whole_number("Steps", "steps", 2, 1000, 20) == 8
    assert "  please give a whole number" in said


@pytest.mark.full
@pytest.mark.parametrize("distance_mm", [SCREEN_MM / 500, SCREEN_MM * 100])
def test_a_scale_that_no_such_mount_has_is_questioned_and_not_taken(mount, distance_mm):
    asked = {"Take it nevertheless": ["no", KeyboardInterrupt()]}
    with pytest.raises(KeyboardInterrupt):
        set_up(mount, asked, distance_mm=distance_mm)
    assert asked["Take it nevertheless"] == []
    assert not calibration.path().exists()


def test_the_least_duty_that_starts_the_motor_is_found_by_halves_and_kept(mount):
    # a person who sees it move from 120 on; 15 ... 255 are tried
    seen = ["yes", "no", "again", "no", "yes"]  # at 135, 75, 105, 105, 120
    answers = {"Find the least duty at which x": ["yes"], "Did the spot move": seen}
    before = mount.x.position
    duties = []
    person = set_up(mount, answers)
    for text in person.said:
        if "at a duty of" in text and "for" in text:
            duties.append(int(text.split("duty of ")[1].split()[0]))
    assert duties == [135, 75, 105, 105, 120]
    assert mount.x.start_duty == 120 and mount.y.start_duty == 0
    assert abs(mount.x.position - before) < 60  # about where it was
    mount.session.send("*RCL1")
    assert mount.x.start_duty == 120


def test_a_motor_that_starts_at_no_duty_is_told_and_nothing_is_set(mount):
    person = set_up(mount, {"Find the least duty at which y": ["yes"], "Did the spot move": ["no"] * 9})
    assert any("y started at none of them" in text for text in person.said) and mount.y.start_duty == 0


def test_a_jog_below_that_duty_is_made_and_warns(mount, caplog):
    mount.apply({"x": {"start_duty": 70}})
    mount.x.jog(0.3)
    assert not caplog.records
    mount.stop()
    mount.x.jog(-0.2)
    mount.sleep(0.5)
    assert mount.status().by_name["x"].moving
    mount.stop()
    assert [record.getMessage() for record in caplog.records] == [
        "x: a duty of 51 is below 70, at which its motor starts (setting start_duty): it may not turn"
    ]
