"""Scales: millimetres a pixel, angles of beam and mirror, and how errors go through."""

import math
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from mirrormount.errors import BadFile, BadValue, NotCalibrated
from mirrormount_beam import scale
from mirrormount_beam.camera import Size
from mirrormount_beam.scale import Measured, Scale

CAMERA = SimpleNamespace(name="USB Camera: 0.1", size=Size(640, 480))
SCALE = Scale(640, 480, 0.05, 0.0005, distance_mm=1500, sigma_distance_mm=15, incidence_deg=45, sigma_incidence_deg=1)


@pytest.fixture(autouse=True)
def _own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))


def board(columns=9, rows=6, side=40, *, squeeze=1.0):
    squares = np.indices((rows + 1, columns + 1)).sum(axis=0) % 2
    image = np.kron(squares, np.ones((side, side))) * 200 + 30
    image = np.pad(image, 40, constant_values=230).astype(np.uint8)
    return cv2.resize(image, (round(image.shape[1] * squeeze), image.shape[0]), interpolation=cv2.INTER_AREA)


def test_a_ruler_gives_millimetres_a_pixel_with_the_error_of_both_points():
    found = scale.of_ruler((10, 10), (310, 410), Measured(100, 0), sigma_px=0.5)
    assert found.value == pytest.approx(0.2)
    assert found.sigma == pytest.approx(0.2 * math.sqrt(2) * 0.5 / 500)


def test_a_checkerboard_gives_the_size_of_its_squares():
    found = scale.of_checkerboard(board(), Measured(5, 0.01), (9, 6))
    assert abs(found.value - 5 / 40) < 3 * found.sigma
    assert found.sigma < 0.01 * found.value


def test_a_checkerboard_at_an_angle_or_missing_is_refused():
    with pytest.raises(BadValue, match="at an angle of about 3"):
        scale.of_checkerboard(board(squeeze=0.8), Measured(5, 0), (9, 6))
    with pytest.raises(BadValue, match="no checkerboard"):
        scale.of_checkerboard(np.full((480, 640), 30, np.uint8), Measured(5, 0), (9, 6))


def test_the_pitch_of_a_bare_sensor_is_the_scale():
    assert scale.of_pitch(Measured(3.0, 0.01)) == pytest.approx(Measured(0.003, 0.00001))
    with pytest.raises(BadValue):
        scale.of_pitch(Measured(3000, 0))


def test_the_beam_turns_by_twice_the_mirrors_angle_in_the_plane_of_incidence_and_less_across_it():
    pixels = Measured(60, 0.3)
    assert SCALE.mm(pixels).value == pytest.approx(3.0)
    assert SCALE.beam_mrad(pixels).value == pytest.approx(2.0)
    assert SCALE.mirror_mrad(pixels, in_plane=True).value == pytest.approx(1.0)
    assert SCALE.mirror_mrad(pixels, in_plane=False).value == pytest.approx(1 / math.cos(math.radians(45)))


@pytest.mark.parametrize("incidence", [0.0, 20.0, 45.0, 70.0])
def test_the_factors_are_those_of_the_law_of_reflection(incidence):
    i = math.radians(incidence)
    ray, turn = np.array([math.sin(i), 0, -math.cos(i)]), 1e-5

    def reflected(normal):
        return ray - 2 * (ray @ normal) * normal

    still = reflected(np.array([0, 0, 1.0]))
    in_plane = np.linalg.norm(reflected(np.array([math.sin(turn), 0, math.cos(turn)])) - still)
    across = np.linalg.norm(reflected(np.array([0, math.sin(turn), math.cos(turn)])) - still)
    seen = Scale(640, 480, 1.0, 0, distance_mm=1000, incidence_deg=incidence)
    for shift, plane in ((in_plane, True), (across, False)):
        found = seen.mirror_mrad(Measured(shift * 1000, 0), in_plane=plane)
        assert found.value == pytest.approx(1000 * turn, rel=1e-4)


def test_stated_errors_are_those_of_random_measurements():
    rng = np.random.default_rng(1)
    n = 4000
    pixels, mm = rng.normal(60, 0.3, n), rng.normal(0.05, 0.0005, n)
    distance, incidence = rng.normal(1500, 15, n), np.radians(rng.normal(45, 1, n))
    spread = np.std(1000 * pixels * mm / distance / (2 * np.cos(incidence)))
    assert SCALE.mirror_mrad(Measured(60, 0.3), in_plane=False).sigma == pytest.approx(spread, rel=0.05)


def test_rotation_cross_talk_and_mirror_image_follow_from_two_steps():
    rotation, cross = 0.1, 0.05
    x = (Measured(10 * math.cos(rotation), 0.02), Measured(10 * math.sin(rotation), 0.02))
    up = rotation - math.pi / 2 + math.asin(cross)
    y = (Measured(8 * math.cos(up), 0.02), Measured(8 * math.sin(up), 0.02))
    found = scale.axes(x, y)
    assert found.x_px.value == pytest.approx(10) and found.y_px.value == pytest.approx(8)
    assert found.rotation_rad == pytest.approx(Measured(rotation, 0.002))
    assert found.cross_talk.value == pytest.approx(cross)
    assert not found.mirrored
    assert scale.axes(x, (Measured(-y[0].value, 0), Measured(-y[1].value, 0))).mirrored
    with pytest.raises(BadValue, match="did not move"):
        scale.axes((Measured(0, 1), Measured(0, 1)), y)


def test_a_saved_scale_is_read_back_and_refused_for_another_size():
    scale.write(CAMERA, SCALE)
    assert scale.read(CAMERA) == SCALE
    with pytest.raises(NotCalibrated, match="is of 640 x 480 pixels, and the camera has 320 x 240"):
        scale.read(SimpleNamespace(name=CAMERA.name, size=Size(320, 240)))
    with pytest.raises(NotCalibrated, match="no scale"):
        scale.read(SimpleNamespace(name="other", size=CAMERA.size))
    with pytest.raises(BadValue):
        scale.write(SimpleNamespace(name="other", size=Size(320, 240)), SCALE)


@pytest.mark.parametrize(
    "content", ["cam = 1", "[cam]\nwidth = 640", "[cam]\nmm_per_px = 'x'", "[cam]\nwith = 1", "[cam]\nmm_per_px = nan"]
)
def test_a_file_that_says_nonsense_is_one_line(content):
    scale.path().write_text(content)
    with pytest.raises(BadFile):
        scale.read(SimpleNamespace(name="cam", size=CAMERA.size))


def test_angles_without_a_distance_are_refused():
    with pytest.raises(NotCalibrated, match="distance"):
        Scale(640, 480, 0.05, 0).beam_mrad(Measured(1, 0))
