"""Facts about the printed parts that follow from their measures, about the files of measures, and about the bill."""

import csv
import importlib.util
import math
import re
import tomllib
from pathlib import Path

import bill
import pytest
from measures import HERE, MOUNTS, MeasureError, find, load, turn_deg

ROOT = Path(__file__).resolve().parents[2]
EVERY_MOUNT = pytest.mark.parametrize("m", [load(path) for path in MOUNTS.values()], ids=list(MOUNTS))


def mount_with(tmp_path, **changes):
    """A file of the KM100's measures with some of them changed; None takes one away."""
    values = {k: v["mm"] for k, v in tomllib.loads(MOUNTS["km100"].read_text()).items() if k != "name"}
    lines = [f"{name} = {value}" for name, value in (values | changes).items() if value is not None]
    path = tmp_path / "mine.toml"
    path.write_text("\n".join(lines))
    return path


def test_every_number_has_a_source():
    for path in (HERE / "hardware.toml", *MOUNTS.values()):
        for name, value in tomllib.loads(path.read_text(encoding="utf-8")).items():
            assert name == "name" or (set(value) == {"mm", "source"} and len(value["source"]) > 5), name


@EVERY_MOUNT
def test_the_motors_are_on_the_axes_of_the_adjusters_and_the_spring_is_between_them(m):
    (x1, y1), (x2, y2) = m.motors
    assert (x2 - x1, y1 - y2) == (m.adjusters_x, m.adjusters_y)
    assert (x1 + x2, y1 + y2) == (0, 0)
    assert [circle[:2] for circle in m.plate_holes()["spring"]] == [(0, 0)]


def test_the_adjusters_of_a_km100_are_as_far_apart_as_another_project_has_them():
    m = load(MOUNTS["km100"])
    assert math.hypot(m.adjusters_x, m.adjusters_y) == pytest.approx(53.3, abs=0.1)  # totesalaz/MKM


@EVERY_MOUNT
def test_a_motors_two_screws_are_9_mm_apart_about_its_shaft(m):
    holes = m.plate_holes()
    for (x, y, _), left, right in zip(
        holes["shaft"], holes["motor screw"][::2], holes["motor screw"][1::2], strict=True
    ):
        assert (left[0], right[0], left[1], right[1]) == pytest.approx((x - 4.5, x + 4.5, y, y))
        assert 1.6 < left[2] < 2.0


@EVERY_MOUNT
def test_no_wall_is_thinner_than_three_lines_of_the_nozzle(m):
    assert set(m.walls()) == {"plate", "spring_ring", "sleeve", "encoder_cap", "switch_bracket", "rod_foot"}
    assert min(m.walls().values()) >= 1.2


@EVERY_MOUNT
def test_the_motors_screws_hold_and_do_not_reach_its_gears(m):
    assert 0.5 <= m.motor_screw_length - m.plate_thickness <= 1.3  # Pololu: at most 1.3


@EVERY_MOUNT
def test_the_sleeve_keeps_the_shaft_over_all_of_its_play(m):
    # shaft above the plate, less what the sleeve stands off when it is farthest out
    assert m.shaft_length - m.plate_thickness - 2 * m.axial_play >= m.shaft_diameter
    assert m.bore_depth > m.shaft_length - m.plate_thickness  # pushed to the plate, the shaft's end touches nothing


def test_a_loose_shaft_turns_until_its_flats_edge_meets_the_wall():
    for degrees in (1.0, 5.0, 10.0):  # the edge of a flat 1 mm from the axis of a shaft of 3 mm, turned
        x, y = 1.0, math.sqrt(1.5**2 - 1)
        a = math.radians(degrees)
        reached = x * math.cos(a) + y * math.sin(a)  # how far out it comes
        assert turn_deg(1.5, 1.0, reached - 1.0) == pytest.approx(degrees)
    assert turn_deg(1.5, 1.0, 0.5) == 90


@EVERY_MOUNT
def test_a_sleeve_whose_set_screws_are_loose_loses_what_the_page_says(m):
    assert [round(angle) for angle in m.loose_deg] == [11, 11]
    assert 1000 <= sum(m.loose_deg) * m.beam_urad_per_deg <= 1110


def test_a_mount_may_be_given_by_plain_numbers_and_has_the_rest_from_the_hardware(tmp_path):
    m = load(mount_with(tmp_path, adjusters_x=40, half_width=27, shaft_length=12))
    assert (m.name, m.adjusters_x, m.shaft_length, m.gearbox_width) == ("mine", 40, 12, 12)
    assert m.sources["adjusters_x"] == "yours"


def test_a_plate_of_sheet_metal_goes_with_shorter_screws(tmp_path):
    assert load(mount_with(tmp_path, plate_thickness=2, motor_screw_length=3)).plate_thickness == 2


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"adjuster_x": 40}, "adjuster_x is no measure"),
        ({"side_hole": None}, "side_hole is missing: measure it"),
        ({"side_hole": '"wide"'}, "side_hole is no number"),
        ({"side_hole": "true"}, "side_hole is no number"),
        ({"side_hole": "{ mm = 5.0 }"}, "side_hole has no source"),
        ({"side_hole": 300}, "side_hole = 300 is not from"),
        ({"side_hole": "nan"}, "side_hole = nan is not from"),
        ({"side_hole": "= 3"}, "is no TOML file"),
        ({"shaft_hole": 6}, "plate: a wall of 0.60 mm"),
        ({"plate_edge": 6}, "plate: a wall of"),
        ({"sleeve_diameter": 6, "key_flats": 5}, "sleeve: a wall of"),
        ({"plate_thickness": 2}, "enter by 2 mm: shorten motor_screw_length"),
        ({"plate_thickness": 4}, "enter by 0 mm: lengthen motor_screw_length"),
        ({"axial_play": 4}, "reduce axial_play"),
        ({"socket_height": 10}, "longer key_free"),
        ({"spring_stretch": 5, "adjusters_y": 35}, "meet the arm of the spring ring"),
        ({"adjusters_x": 30, "adjusters_y": 30}, "the switches of both axes meet"),
        ({"half_width": 20}, "meets the spring ring"),
        ({"fit": 0.8, "plate_edge": 11, "motor_screws_apart": 11, "least_wall": 0.4}, "would slip in the sleeve"),
    ],
)
def test_what_is_wrong_with_measures_is_one_line_that_names_the_measure(tmp_path, changes, told):
    with pytest.raises(MeasureError, match=re.escape(told)) as error:
        load(mount_with(tmp_path, **changes))
    assert "mine.toml" in str(error.value) and "\n" not in str(error.value)


def test_a_mount_that_nobody_knows_is_told_with_those_that_are(tmp_path):
    assert [name for name, _ in find([])] == ["km100", "polaris-k1", "u100"]
    ((name, path),) = find(["u200"])
    assert name == "u200"
    with pytest.raises(MeasureError, match=r"u200: .*km100, polaris-k1, u100"):
        load(path)


@pytest.mark.full
def test_a_full_run_has_what_the_tests_of_solids_need():
    assert importlib.util.find_spec("build123d"), "test_solids.py was left out"


# The bill


def test_the_totals_of_the_bill_are_the_sums_of_its_parts(tmp_path):
    bill.write(tmp_path / "bill.csv")
    with (tmp_path / "bill.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    parts = [row for row in rows if row["group"]]
    assert all(row["source"] and int(row["count"]) > 0 for row in parts)
    cost = {row["part"]: int(row["count"]) * float(row["usd_each"]) for row in parts}
    optional = ("switches", "encoders")
    needed = sum(cost[row["part"]] for row in parts if row["group"] not in optional)
    told = {row["part"]: float(row["usd"]) for row in rows if not row["group"]}
    assert told["total with the mount"] == pytest.approx(needed)
    assert told["total without the mount"] == pytest.approx(needed - 150)
    assert told["total with switches and encoders"] == pytest.approx(sum(cost.values()))


def test_the_bill_has_a_motor_a_sleeves_screws_and_a_key_for_each_axis():
    count = {row["part"].split(",")[0]: int(row["count"]) for row in bill.rows()}
    assert count["gearmotor Pololu #3058"] == count["hex key 5/64 inch"] == 2
    assert count["screw M1.6 x 4"] == count["set screw M3 x 5"] == 4


def test_the_page_tells_the_sum_of_the_bill():
    page = (ROOT / "docs" / "bring-up.md").read_text(encoding="utf-8")
    assert f"about {round(bill.totals()['total without the mount'], -1):.0f} USD" in page
