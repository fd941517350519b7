"""Boards, mirrors and cameras on one clock: what a program drives through ports, it sees through cameras."""

import time

import numpy as np
import pytest
from centroids import centroid

from mirrormount.device.mount import Mount
from mirrormount.errors import BadAddress, ConnectionLost
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_table
from mirrormount_sim.simulation import START_US
from mirrormount_sim.table import LockstepClock, VirtualTable

STEP_US = 200  # the longest time that a board's processor needs for one pass of its loop, on the fake clock


def opened(options: str = "") -> VirtualTable:
    table = open_table("virtual-table://" + options)
    assert isinstance(table, VirtualTable)
    return table


def mounts(table: VirtualTable) -> list[Mount]:
    return [Mount(Link(port)) for port in table.ports]


def times_us(table: VirtualTable) -> list[int]:
    """The time that each board has reached."""
    assert isinstance(table.clock, LockstepClock)
    return [table.clock.board(simulation).at_us - START_US for simulation in table.simulations]


def behind_us(table: VirtualTable) -> int:
    """How far the boards' times are apart."""
    return max(times_us(table)) - min(times_us(table))


def test_two_boards_stay_on_one_clock_whoever_waits():
    with opened() as table:
        first, second = mounts(table)
        assert first.board_id != second.board_id
        frames = table.cameras[0].frames()
        for act in (
            lambda: first.x.step(3),
            lambda: second.y.step(-2),
            lambda: table.sleep(0.7),
            lambda: next(frames),
            lambda: first.sleep(1.3),
        ):
            before = table.now_s()
            act()
            assert behind_us(table) < STEP_US
            assert table.now_s() > before
            for us in times_us(table):
                assert us * 1e-6 == pytest.approx(table.now_s(), abs=STEP_US * 1e-6)


def test_two_boards_that_are_told_at_once_drive_at_once_however_long_they_have_rested():
    with opened() as table:
        mounts(table)
        table.sleep(1.2345)
        told_us = table.now_s() * 1e6
        for port in table.ports:
            port.write(b"2PR1\n")
        table.sleep(1.0)
        for simulation in table.simulations:
            started = [us for us, pin, duty in simulation.edges if pin == "m2_en" and duty]
            ended = [us for us, pin, duty in simulation.edges if pin == "m2_en" and not duty]
            assert len(started) == 1 and 0 < started[0] - told_us < 5 * STEP_US
            assert ended[-1] - started[0] == pytest.approx(200_000, abs=100)


def test_a_motion_on_one_board_goes_on_while_another_is_waited_for():
    with opened() as table:
        first, second = mounts(table)
        first.send("XK0")
        first.link.write(b"2PR5\n")
        second.x.step(1)
        assert 1 <= first.x.position <= 4


def test_every_axis_moves_the_beam_and_the_cameras_see_it():
    with opened() as table:
        frames = [camera.frames() for camera in table.cameras]

        def seen() -> np.ndarray:
            pictures = [next(each) for each in frames]
            return np.array([centroid(picture.image) for picture in pictures])

        for mount in mounts(table):
            for axis in mount.axes:
                axis.step(2)  # through the gap
                for _ in range(3):
                    before = seen()
                truth = np.array(table.truth.spots_mm(table.now_s()))
                axis.step(3)
                for _ in range(4):  # the first frames were exposed before the end of the motion
                    after = seen()
                moved = np.array(table.truth.spots_mm(table.now_s())) - truth
                expected = [
                    np.subtract(camera.truth_px((dx, dy)), camera.truth_px((0.0, 0.0)))
                    for camera, (dx, dy) in zip(table.cameras, moved, strict=True)
                ]
                assert np.abs(moved).max() > 0.4
                assert after - before == pytest.approx(np.array(expected), abs=0.8)


def test_a_board_without_drive_does_not_move_the_beam():
    with opened("?mounts=1") as table:
        (mount,) = mounts(table)
        mount.x.step(2)
        simulation = table.simulations[0]
        still = table.truth.mirrors_urad(table.now_s())[0]
        simulation.bench.wires = {}  # every wire between board and bridge is cut
        mount.x.step(5)
        assert mount.x.position == 7  # the board counts what it drives
        assert table.truth.mirrors_urad(table.now_s())[0] == pytest.approx(still, abs=3.0)  # vibration and drift


@pytest.mark.parametrize("profile", ["smooth", "rough"])
def test_a_run_repeats_to_the_last_grey_value_and_another_seed_is_another_table(profile):
    def run(seed: int) -> tuple[object, bytes]:
        with opened(f"?profile={profile}&seed={seed}&off=3") as table:
            for mount in mounts(table):
                mount.x.step(2)
            pictures = [next(camera.frames()).image.tobytes() for camera in table.cameras]
            return table.truth.spots_mm(table.now_s()), b"".join(pictures)

    assert run(5) == run(5)
    assert run(5)[0] != run(6)[0]


def test_events_happen_at_their_time_also_in_the_middle_of_a_motion():
    with opened("?mounts=1&cameras=1") as table:
        (mount,) = mounts(table)
        at = table.now_s() + 0.55
        seen = []
        table.clock.at(at, lambda: (seen.append(table.now_s()), table.truth.bump(0, 500.0, 0.0)))
        mount.y.step(3)
        assert seen == [pytest.approx(at, abs=STEP_US * 1e-6)]
        assert table.truth.mirrors_urad(table.now_s())[0][0] == pytest.approx(500.0, abs=5.0)


def test_a_board_that_is_unplugged_is_lost_and_the_others_go_on():
    with opened() as table:
        first, second = mounts(table)
        first.send("XK0")
        first.link.write(b"2MV+\n")
        table.sleep(0.3)
        table.ports[0].close()
        with pytest.raises(ConnectionLost):
            first.status()
        assert not any(table.simulations[0].bench.duties().values())
        still = table.truth.mirrors_urad(table.now_s())[0]
        second.x.step(2)
        table.sleep(1.0)
        assert table.truth.mirrors_urad(table.now_s())[0] == pytest.approx(still, abs=60.0)  # it coasted, and stands


def test_a_board_that_is_plugged_in_again_has_its_settings_and_its_mount_stands_as_it_stood():
    with opened() as table:
        first, _ = mounts(table)
        first.x.step(4)
        first.x.take_up_us = 123_000
        first.save()
        still = table.truth.mirrors_urad(table.now_s())[0]
        table.ports[0].close()
        table.sleep(2.0)
        again = Mount(Link(table.replug(0)))
        assert (again.board_id, again.x.take_up_us) == (first.board_id, 123_000)
        assert table.truth.mirrors_urad(table.now_s())[0] == pytest.approx(still, abs=3.0)
        again.x.step(2)
        assert table.truth.mirrors_urad(table.now_s())[0][0] - still[0] > 300
        assert behind_us(table) < STEP_US


def test_a_table_in_real_time_moves_what_its_camera_sees():
    with opened("?mounts=1&cameras=1&speed=1") as table:
        (mount,) = mounts(table)
        frames = table.cameras[0].frames()
        before = centroid(next(frames).image)
        mount.x.step(2)
        end_s = table.now_s()
        after = next(frame for frame in frames if frame.time_s > end_s + 0.05)
        assert centroid(after.image)[0] - before[0] > 10  # one step of the two goes through the gap
        mount.close()


@pytest.mark.parametrize(
    "option",
    ["mounts=3", "boards=2&mounts=1", "cameras=0", "off=40", "off=-1", "off=nan", "speed=2", "seed=x", "a=1"],
)
def test_an_unknown_option_is_refused_in_one_line(option):
    with pytest.raises(BadAddress) as refused:
        open_table(f"virtual-table://?{option}")
    assert "\n" not in str(refused.value)


def test_an_address_of_no_table_is_refused():
    with pytest.raises(BadAddress):
        open_table("virtual://")


def test_the_rest_of_a_microsecond_passes_too():
    """Mount.sleep() waits for what is left; were that rounded to nothing, it would wait for ever."""
    with opened("?mounts=1&cameras=1") as table:
        port = table.ports[0]
        before = port.monotonic()
        for _ in range(50):  # the board may be some microseconds ahead of the table
            port.sleep(3e-7)
        assert port.monotonic() > before


def test_a_board_that_the_computer_keeps_from_running_moves_no_further_than_its_firmware_let_it(monkeypatch):
    with opened("?mounts=1") as table:
        (mount,) = mounts(table)
        mount.send("XK0")
        mount.link.write(b"2PR1\n")
        table.sleep(0.1)  # in mid-step: the motor is on, and ends by the firmware alone
        (simulation,) = table.simulations
        begun = simulation.mirrors_now_rad()
        later_s = time.monotonic() + 60
        monkeypatch.setattr("mirrormount_sim.simulation.time.monotonic", lambda: later_s)
        starved = simulation.mirrors_now_rad()
        monkeypatch.undo()
        table.sleep(1)
        ended = simulation.bench.mirrors_rad()
        way = abs(ended[0][0] - begun[0][0])
        assert way > 20e-6
        assert abs(starved[0][0] - begun[0][0]) <= way


def test_the_edges_that_a_board_keeps_are_the_last_ones(monkeypatch):
    monkeypatch.setattr("mirrormount_sim.simulation.EDGES_KEPT", 6)
    with opened("?mounts=1") as table:
        (mount,) = mounts(table)
        (simulation,) = table.simulations
        for _ in range(12):
            mount.x.pulse(1000)
            table.sleep(0.05)
        assert 6 <= len(simulation.edges) < 12
        assert simulation.edges[-1][0] * 1e-6 > table.now_s() - 0.2
