"""The beam's way over the table: three dimensions beside the formulas of small angles, and angles that wander."""

import math

import numpy as np
import pytest

from mirrormount_sim.optics import BeamPath, Drift, Geometry
from mirrormount_sim.table import Table

GEOMETRY = Geometry(laser_m=0.5, between_m=0.6, cameras_m=(0.4, 1.6))
SMALL = 1e-4  # rad
REST = (0.0, 0.0)


def moved(mirrors: list[tuple[float, float]], offset_mm=REST, angle_rad=REST) -> list[tuple[float, float]]:
    path = BeamPath(len(mirrors), GEOMETRY)
    spots = path.spots(offset_mm, angle_rad, mirrors)
    assert None not in spots
    return spots  # type: ignore[return-value]


def test_with_all_at_rest_the_beam_hits_the_middle_of_every_camera():
    for mirrors in (1, 2):
        for spot in moved([REST] * mirrors):
            assert spot == pytest.approx((0, 0), abs=1e-9)


@pytest.mark.parametrize(
    ("mirrors", "direction", "metres"),
    [
        # a mirror at 45 degrees turns the beam by twice its yaw, and by the root of two times its pitch
        ([(SMALL, 0)], (2, 0), (0.4, 1.6)),
        ([(0, SMALL)], (0, math.sqrt(2)), (0.4, 1.6)),
        ([(SMALL, 0), REST], (-2, 0), (1.0, 2.2)),  # the second mirror exchanges right and left
        ([(0, SMALL), REST], (0, math.sqrt(2)), (1.0, 2.2)),
        ([REST, (SMALL, 0)], (2, 0), (0.4, 1.6)),
        ([REST, (0, SMALL)], (0, math.sqrt(2)), (0.4, 1.6)),
    ],
)
def test_a_turned_mirror_moves_the_spots_as_the_small_angle_says(mirrors, direction, metres):
    for spot, way_m in zip(moved(mirrors), metres, strict=True):
        small = SMALL * way_m * 1e3
        assert spot == pytest.approx((direction[0] * small, direction[1] * small), abs=small * 2e-3)


def test_the_laser_moves_the_spots_by_its_offset_and_by_its_angle_times_the_way():
    near, far = moved([REST, REST], offset_mm=(0.3, -0.2))
    assert near == pytest.approx((0.3, -0.2), abs=1e-6) and far == pytest.approx((0.3, -0.2), abs=1e-6)
    near, far = moved([REST, REST], angle_rad=(SMALL, 2 * SMALL))
    assert near == pytest.approx((SMALL * 1500, 2 * SMALL * 1500), rel=1e-3)
    assert far == pytest.approx((SMALL * 2700, 2 * SMALL * 2700), rel=1e-3)


def test_a_large_angle_is_not_the_small_ones_multiple():
    (spot,) = BeamPath(1, Geometry(cameras_m=(1.0,))).spots(REST, REST, [(0.2, 0.0)])
    assert spot == pytest.approx((math.tan(0.4) * 1e3, 0), abs=1e-6)


def test_a_beam_that_misses_the_second_mirror_comes_nowhere():
    path = BeamPath(2, GEOMETRY)
    assert path.spots(REST, REST, [(0.02, 0), REST]) == [None, None]
    assert path.spots(REST, REST, [(2.0, 0), REST]) == [None, None]


def test_a_drift_grows_as_the_root_of_time_and_a_jitter_does_not():
    ends, jitters = [], []
    for seed in range(300):
        ends.append(Drift(np.random.default_rng(seed), 3.0, 0.0).at(25.0)[0])
        jitters.append(Drift(np.random.default_rng(seed), 0.0, 2.0).at(25.0)[1])
    assert np.std(ends) * 1e6 == pytest.approx(3.0 * 5, rel=0.12)
    assert np.std(jitters) * 1e6 == pytest.approx(2.0, rel=0.12)


def test_a_drift_does_not_depend_on_how_often_it_is_looked_at():
    often, once = (Drift(np.random.default_rng(7), 3.0, 1.0) for _ in range(2))
    for k in range(1, 1000):
        often.at(k * 0.0137)
    assert often.at(20.0) == pytest.approx(once.at(20.0), abs=1e-15)


def still(mirrors: int = 2) -> Table:
    table = Table([lambda: [REST] * mirrors], mirrors, GEOMETRY, seed=3)
    for drift in (table.laser.drift, *table.vibrations):
        drift.drift_urad = drift.jitter_urad = 0.0
    return table


def test_a_blocked_laser_comes_nowhere_and_comes_back_where_it_was():
    table = still()
    before = table.spots_mm(1.0)
    table.laser.blocked = True
    assert table.spots_mm(2.0) == [None, None]
    table.laser.blocked = False
    assert table.spots_mm(3.0) == before


def test_a_bumped_mount_stays_turned():
    table = still()
    table.bump(1, 500.0, 0.0)
    assert table.mirrors_urad(0.0) == [(0.0, 0.0), pytest.approx((500.0, 0.0))]
    assert table.spots_mm(1.0)[1] == pytest.approx((1.6, 0.0), abs=0.01)


@pytest.mark.parametrize("seed", range(5))
def test_a_misaligned_laser_is_off_by_what_was_asked_for(seed):
    table = still()
    table.misalign(9.0, np.random.default_rng(seed))
    assert max(abs(x) for spot in table.spots_mm(0.0) for x in spot) == pytest.approx(9.0, rel=0.01)
