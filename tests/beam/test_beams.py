"""Beams and sensors of the virtual camera: the shape of the light, its declared place, and what a sensor does to it."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scenes

from mirrormount_sim import beams
from mirrormount_sim.optics import EXPOSURE_S, Sensor
from mirrormount_sim.profiles import ROUGH, SMOOTH
from mirrormount_sim.table import new_webcam

DARK = np.zeros((480, 640), np.float32)
LIT = np.full((480, 640), 100.0, np.float32)


def rng(seed):
    return np.random.default_rng(seed)


def exposed(light, defects=beams.GOOD, seed=1, **facts):
    return beams.expose(light, rng(seed), defects, **facts)


def quiet(light, defects=beams.GOOD):
    """Without noise and dark level."""
    return exposed(light, defects, black=0.0, read_noise=0.0, electrons=1e12)


def gaussian(sigma, x, y, shape):
    rows, columns = np.indices(shape)
    return np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * sigma**2))


# ---- the beam


@pytest.mark.parametrize("kind", beams.SHAPES)
def test_light_is_never_negative_and_has_a_peak_of_one(kind):
    for seed in range(10):
        light = beams.light_of(beams.draw_beam(rng(seed), 20.0, kind), 320.3, 240.6, DARK.shape)
        assert light.min() >= 0 and light.max() == pytest.approx(1, abs=0.02)


def test_a_beam_without_defects_is_a_gaussian():
    light = beams.light_of(replace(beams.GAUSSIAN, sigma=20.0), 320.3, 240.6, DARK.shape)
    assert np.abs(light - gaussian(20.0, 320.3, 240.6, DARK.shape)).max() < 1e-4


def test_the_same_seed_draws_the_same_beam_and_another_seed_another_one():
    first, again, other = (beams.draw_beam(rng(seed), 12.0, *beams.SHAPES) for seed in (1, 1, 2))
    assert first == again and first != other
    assert np.array_equal(*(beams.light_of(beam, 300.7, 200.1, DARK.shape) for beam in (first, again)))


def test_a_clipped_beam_is_dark_behind_the_edge():
    sigma, edge = 20.0, 1.5
    light = beams.light_of(beams.Beam(sigma, aperture=beams.Aperture(edge, 0.0)), 320.0, 240.0, DARK.shape)
    lit = np.flatnonzero(light[240] > 0.01)
    assert lit[-1] - np.argmax(light[240]) == pytest.approx(edge * sigma, abs=1.5)
    assert np.argmax(light[240]) - lit[0] == pytest.approx(sigma * math.sqrt(2 * math.log(100)), abs=1.5)


# ---- its declared place


@pytest.mark.parametrize("sigma", [1.5, 2.0, 3.0, 5.0, 12.0, 40.0, 100.0])
def test_the_declared_place_of_a_gaussian_is_its_centre(sigma):
    half = int(4 * sigma) + 4
    most_px = 1e-3 if sigma >= 3 else 2e-3  # a window's edge of less than 2 px is sampled by pixels
    for seed in range(4):
        x, y = half + rng(seed).uniform(-0.5, 0.5, 2)
        assert beams.declared_place(gaussian(sigma, x, y, (2 * half + 1,) * 2)) == pytest.approx((x, y), abs=most_px)


def test_the_declared_place_of_an_ellipse_is_its_centre():
    light = beams.light_of(beams.Beam(15.0, 2.0, 0.6), 320.3, 240.6, DARK.shape)
    assert beams.declared_place(light) == pytest.approx((320.3, 240.6), abs=1e-3)


@pytest.mark.parametrize("kind", beams.SHAPES)
@pytest.mark.parametrize("sigma", [1.5, 4.0, 15.0])
def test_the_declared_place_is_where_a_beam_was_put_and_moves_with_it(kind, sigma):
    for seed in range(3):
        beam = beams.draw_beam(rng(seed), sigma, kind)
        half = int(beam.reach) + 20
        shape = (2 * half, 2 * half)
        for x, y in ((half, half), (half + 10.3, half - 3.7)):
            assert beams.declared_place(beams.light_of(beam, x, y, shape)) == pytest.approx((x, y), abs=0.02)


def test_the_declared_place_of_a_skewed_beam_is_neither_its_peak_nor_where_far_light_draws_it():
    beam = beams.Beam(20.0, skew=(0.08, 0.0), halo=0.02)
    light = beams.light_of(beam, 320.0, 240.0, DARK.shape)
    peak = np.unravel_index(light.argmax(), light.shape)[1]
    assert abs(peak - 320) > 2
    light[400:440, 20:60] = 0.2
    assert beams.declared_place(light) == pytest.approx((320, 240), abs=0.1)


def test_the_factor_of_the_light_above_half_is_that_of_a_gaussian():
    """Internal: the number stands in the definition."""
    r = np.linspace(0, 4, 400_001)
    above = np.clip(np.exp(-r * r / 2) - 0.5, 0, None) * r
    assert (above * r * r / 2).sum() / above.sum() == pytest.approx(beams._ABOVE_HALF, abs=1e-5)


# ---- the sensor


def test_a_good_sensor_gives_the_light_and_its_noise():
    assert np.array_equal(quiet(LIT), LIT)
    frame = exposed(LIT, black=6.0, read_noise=1.5, electrons=47.0).astype(float)
    assert frame.mean() == pytest.approx(106, abs=0.05)
    assert frame.std() == pytest.approx(math.sqrt(1.5**2 + 100 / 47 + 1 / 12), rel=0.01)


def test_odd_rows_have_their_factor():
    frame = quiet(LIT, beams.Defects(odd_rows=0.67))
    assert np.all(frame[::2] == 100) and np.all(frame[1::2] == 67)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_values_have_their_bits(bits):
    frame = quiet(np.linspace(0, 400, LIT.size, dtype=np.float32).reshape(LIT.shape), beams.Defects(bits=bits))
    assert frame.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert frame.max() == 2**bits - 1
    assert len(np.unique(frame)) > 0.95 * 2**bits  # no lower bit is always 0
    assert np.interp(100, [0, 400], [0, LIT.size]) == pytest.approx(
        np.searchsorted(frame.ravel(), 100 << (bits - 8)), rel=0.01
    )


def test_columns_and_pixels_stay_and_rows_change():
    defects = beams.Defects(columns=3.0, hot=20, dead=20)
    first, second = (exposed(LIT, defects, seed, read_noise=0.0, electrons=1e12) for seed in (1, 2))
    assert np.array_equal(first, second)
    assert np.std(np.median(first, axis=0)) == pytest.approx(3, rel=0.15)
    assert 10 < np.count_nonzero(first == 0) <= 20 and 10 < np.count_nonzero(first > 130) <= 20
    first, second = (exposed(LIT, beams.Defects(rows=3.0), seed, read_noise=0.0) for seed in (1, 2))
    rows = [frame.mean(axis=1) for frame in (first, second)]
    assert np.std(rows[0]) == pytest.approx(3, rel=0.15) and abs(np.corrcoef(rows)[0, 1]) < 0.2


def test_smear_is_a_streak_through_the_spot():
    light = 200 * beams.light_of(beams.GAUSSIAN, 320.0, 240.0, DARK.shape)
    frame = exposed(light, beams.Defects(smear=0.5), black=10.0)
    assert frame[:50, 315:326].mean() - frame[:50, :100].mean() == pytest.approx(
        0.5 * light[:, 315:326].mean(), rel=0.1
    )


def test_one_colour_saturates_before_the_others():
    light = 500 * beams.light_of(beams.GAUSSIAN, 320.0, 240.0, DARK.shape)
    frame = exposed(light, beams.Defects(colour=(1.0, 0.1, 0.3)))
    assert frame.shape == (480, 640, 3)
    blue, green, red = (int(channel.max()) for channel in np.moveaxis(frame, 2, 0))
    assert blue == 255 and 45 < green < 80 and 140 < red < 190


def test_gamma_lifts_what_is_dark_and_jpeg_changes_little():
    assert quiet(LIT, beams.Defects(gamma=0.5))[0, 0] == round(255 * math.sqrt(100 / 255))
    light = 200 * beams.light_of(beams.GAUSSIAN, 320.0, 240.0, DARK.shape)
    off = quiet(light, beams.Defects(jpeg=75)).astype(float) - quiet(light)
    assert 0.1 < off.std() < 3


def test_a_frame_is_of_the_seed():
    defects = beams.draw_defects(rng(1), "columns")
    assert np.array_equal(exposed(LIT, defects), exposed(LIT, defects))
    assert not np.array_equal(exposed(LIT, defects), exposed(LIT, defects, 2))


# ---- the cameras of a table, and scenes


def test_a_rough_table_has_real_beams_and_a_smooth_one_has_gaussians():
    sensor, _ = new_webcam(SMOOTH, rng(1), real=True)
    assert sensor.beam == beams.GAUSSIAN and sensor.defects == beams.GOOD
    sensor, _ = new_webcam(ROUGH, rng(1))
    assert any(sensor.beam.skew) and sensor.defects.jpeg is None and sensor.window is None
    assert sensor.picture([(0.0, 0.0)], 0.0).dtype == np.uint8


def test_the_place_of_a_real_beam_in_a_frame_is_that_of_its_spot():
    sensor, _ = new_webcam(ROUGH, rng(3), real=True)
    sensor = Sensor(beam=sensor.beam, ambient=0.0, black=0.0, read_noise=0.0, electrons=1e12)
    for spot in ((0.0, 0.0), (2.345, -4.321)):
        assert beams.declared_place(sensor.picture([spot], 0.0)) == pytest.approx(sensor.place(spot), abs=0.05)


def test_a_window_is_as_bright_as_the_exposure_is_long():
    window = beams.Window(100.0, 50.0, 40.0, 30.0, 60.0)
    sensor = Sensor(window=window, ambient=0.0, black=0.0, read_noise=0.0, electrons=1e12)
    assert sensor.picture([], 0.0)[50, 100] == 60
    sensor.exposure_s = EXPOSURE_S / 2
    frame = sensor.picture([], 0.0)
    assert frame[50, 100] == 30 and frame[50, 160] == 0


@pytest.mark.parametrize("kind", scenes.ONE_BEAM + scenes.NO_BEAM)
def test_each_kind_of_scene_is_drawn_by_seed_and_has_a_truth_if_it_has_one_beam(kind):
    scene, again = (scenes.real(rng(5), kind) for _ in range(2))
    assert np.array_equal(scene.image, again.image) and scene.parts == [kind]
    assert (scene.truth is not None) == (kind in scenes.ONE_BEAM)
    if scene.truth:
        rows, columns = scene.image.shape[:2]
        assert 0 < scene.truth[0] < columns and 0 < scene.truth[1] < rows
