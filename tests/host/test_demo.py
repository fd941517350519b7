"""The demo measures, and can be wrong: each of four faults changes its table and fails it."""

from dataclasses import replace

import pytest
from closed_loop import ClosedLoop
from full_disk import run_with_room

from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue, DemoFailed
from mirrormount_sim import demo
from mirrormount_sim.bench import DRIVES


def measure(prepare=lambda mount: None) -> dict[str, demo.Row]:
    with Mount.open("virtual://?speed=max") as mount:
        prepare(mount)
        corners, _, _ = demo.square(mount)
    return {row.what: row for row in demo.table(corners)}


def bad(rows: dict[str, demo.Row]) -> set[str]:
    return {what for what, row in rows.items() if not row.good}


def bench(mount: Mount):
    return mount.link.port.simulation.bench


def test_the_square_has_the_papers_figures():
    rows = measure()
    assert bad(rows) == set()
    assert rows["step, horizontal"].measured == pytest.approx(0.43, rel=0.05)
    assert rows["step, vertical"].measured == pytest.approx(0.47, rel=0.05)
    assert rows["backlash, horizontal"].measured == pytest.approx(0.64, rel=0.15)
    assert rows["backlash, vertical"].measured == pytest.approx(0.70, rel=0.15)


@pytest.mark.full
@pytest.mark.parametrize("profile", ["smooth", "rough"])
def test_the_square_of_a_mount_with_much_supply_is_in_the_picture(profile):
    with ClosedLoop(profile, 1.3, closed=False).mount as mount:
        demo.close_loop(mount)
        corners, _, _ = demo.square(mount)
    assert max(x for x, _ in corners) - min(x for x, _ in corners) > 50


def test_a_pulse_ten_percent_long_fails_it():
    rows = measure(lambda mount: mount.ask("1XP220000;2XP220000;XK?"))
    assert {"step, horizontal", "step, vertical"} <= bad(rows)


def test_swapped_legs_fail_it(monkeypatch):
    monkeypatch.setitem(DRIVES, 6, "m2_neg")
    monkeypatch.setitem(DRIVES, 7, "m2_pos")
    rows = measure()
    assert rows["step, horizontal"].measured < 0
    assert "step, horizontal" in bad(rows)


def test_another_gap_fails_it():
    def widen(mount: Mount) -> None:
        bench(mount).horizontal.gap_rev *= 1.3

    assert {"backlash, horizontal"} <= bad(measure(widen))


def test_another_screw_fails_it():
    def coarsen(mount: Mount) -> None:
        bench(mount).vertical.pitch_mm = 0.35

    assert {"step, vertical"} <= bad(measure(coarsen))


def closures(spoil_us: int = 0) -> list[demo.Closure]:
    with Mount.open("virtual://?speed=max") as mount:
        x_us, y_us = demo.take_up(mount, demo.table(demo.square(mount)[0]))
        mount.x.take_up_us, mount.y.take_up_us = x_us + spoil_us, y_us - spoil_us
        return demo.closure(demo.square(mount)[0])


def test_the_square_closes_with_the_backlash_taken_up():
    assert [row.measured for row in closures()] == pytest.approx([0, 0], abs=0.03)


def test_a_wrong_take_up_leaves_it_open():
    # 30 ms is 0.06 mrad
    assert not any(row.good for row in closures(spoil_us=30_000))


def rough_loop(seed: int, **without: float) -> ClosedLoop:
    """A rough mount with encoders, without some of what no encoder sees."""
    loop = ClosedLoop("rough", seed=seed)
    for train in loop.bench.trains.values():
        train.profile = replace(train.profile, **without)
    return loop


@pytest.mark.full
@pytest.mark.parametrize("seed", [1, 2])
def test_with_encoders_neither_creep_nor_a_crooked_screw_leaves_the_square_open(seed):
    loop = rough_loop(seed, gap_spread=0.0)
    with loop.mount as mount:
        corners = demo.square(mount, waits=True)[0]
        demo.take_up_by_steps(mount, corners)
        closed = demo.closure(demo.square(mount, waits=True)[0], demo.MEASURED_MRAD)
    assert all(row.good for row in closed), closed


def test_steps_that_do_not_close_the_square_end_the_demo():
    loop = rough_loop(1)
    with loop.mount as mount, pytest.raises(DemoFailed, match="12 steps more"):
        demo.take_up_by_steps(mount, [(-200.0, 0.0), (0.0, 0.0)])


def test_steps_that_differ_by_more_than_the_backlash_end_the_demo_in_one_line():
    with Mount.open("virtual://?speed=max") as mount, pytest.raises(DemoFailed, match="no backlash"):
        demo.take_up(mount, demo.table([(0, 0), (66, 0), (66, -72), (5, -72), (5, 4)]))


def test_a_take_up_that_fails_is_an_error_after_the_picture_was_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(demo, "take_up", lambda mount, rows: (0, 0))
    with pytest.raises(DemoFailed, match="the backlash was not taken up: left open, horizontal, left open, vertical"):
        demo.demonstrate("virtual://?speed=max", tmp_path / "square.png")


@pytest.mark.full
def test_encoders_behind_the_gears_are_not_blamed_for_the_backlash_that_they_see(tmp_path, capsys):
    demo.demonstrate("virtual://?speed=max&encoder=shaft", tmp_path / "square.png")
    said = capsys.readouterr().out
    assert "NOT OK" not in said and said.count("of the couplers") == 3


def test_a_bad_table_is_an_error_after_the_picture_was_drawn(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(demo, "STEP_X_MRAD", 0.5)
    output = tmp_path / "square.png"
    with pytest.raises(DemoFailed, match="step, horizontal"):
        demo.demonstrate("virtual://?speed=max", output)
    assert output.read_bytes().startswith(b"\x89PNG")
    assert "NOT OK" in capsys.readouterr().out


def test_the_demo_runs_on_a_virtual_board_only():
    with pytest.raises(BadValue):
        demo.demonstrate("/dev/ttyACM0", None)


def test_a_spot_is_found_to_a_fraction_of_a_pixel_and_darkness_is_not_a_spot():
    import numpy as np

    noise = np.random.default_rng(3)
    picture = demo.VIEW.picture((12.34, -56.78), noise)
    x, y = demo.VIEW.centroid(picture)
    assert (x, y) == pytest.approx((12.34, -56.78), abs=0.02)
    assert demo.VIEW.centroid(demo.VIEW.picture((1000, 1000), noise)) is None


@pytest.mark.full
def test_a_picture_that_the_disk_has_no_room_for_is_told_by_its_name_and_leaves_no_file(tmp_path):
    pytest.importorskip("resource")
    picture = tmp_path / "square.png"
    run = run_with_room(100_000, "demo", "--output", str(picture))
    assert run.returncode == 1 and "NOT OK" not in run.stdout
    assert run.stderr == f"mirrormount: cannot write {picture}: File too large\n"
    assert list(tmp_path.iterdir()) == []
