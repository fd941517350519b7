"""The table's cameras: what a frame shows, when it comes, and what becomes of it when something fails."""

import itertools

import numpy as np
import pytest
from centroids import centroid

from mirrormount_beam.errors import CameraBlack, CameraGone, CameraRepeats, CameraSizeChanged
from mirrormount_sim.optics import EXPOSURE_S, Sensor
from mirrormount_sim.table import FRAMES_S, LATENCY_S, LockstepClock, TableCamera, Timing


def camera(sensor: Sensor | None = None, timing: Timing | None = None, look=lambda t: [(1.0, -2.0)]) -> TableCamera:
    return TableCamera("camera", sensor or Sensor(), timing or Timing(), look, LockstepClock([]))


def test_the_spot_of_a_frame_is_where_the_beam_is():
    sensor = Sensor(rotation_deg=4.0)
    errors = []
    for place in ((0.0, 0.0), (3.217, -4.105), (-7.41, 2.03)):
        image = sensor.picture([place], 0.0)
        assert image.dtype == np.uint8 and image.shape == (480, 640)
        errors.append(np.subtract(centroid(image), sensor.place(place)))
    assert np.abs(errors).max() < 0.06


def test_right_is_right_up_is_up_and_a_rotation_turns_clockwise():
    assert Sensor().place((1.0, 2.0)) == pytest.approx((319.5 + 20, 239.5 - 40))
    assert Sensor(rotation_deg=90).place((1.0, 0.0)) == pytest.approx((319.5, 239.5 + 20))
    assert Sensor(rotation_deg=90).place((0.0, 1.0)) == pytest.approx((319.5 + 20, 239.5))
    assert Sensor(pixel_mm=0.1).place((1.0, 0.0)) == pytest.approx((329.5, 239.5))


def test_light_follows_exposure_and_gain_and_saturates():
    def peak(**facts: float) -> int:
        return int(Sensor(read_noise=0.0, electrons=1e9, **facts).picture([(0.0, 0.0)], 0.0).max())

    assert peak() == pytest.approx(6 + 8 + 180, abs=1)
    assert peak(exposure_s=EXPOSURE_S / 2) == pytest.approx(6 + 4 + 90, abs=1)
    assert peak(gain=0.5) == pytest.approx(6 + 4 + 90, abs=1)
    assert peak(gain=2.0) == 255


def test_the_noise_is_read_noise_and_shot_noise():
    sensor = Sensor(ambient=0.0, black=20.0)
    pictures = np.array([sensor.picture([(0.0, 0.0)], 0.0) for _ in range(60)], float)
    dark = pictures[:, :100, :100].std(axis=0).mean()
    assert dark == pytest.approx(np.hypot(1.5, 12**-0.5), rel=0.05)  # and that of rounding
    bright = pictures[:, 238:242, 318:322].std(axis=0).mean()
    assert bright == pytest.approx(np.sqrt(1.5**2 + 180 / 47), rel=0.1)


def test_hot_pixels_stay_where_they_are_and_a_ghost_has_its_share():
    sensor = Sensor(hot_pixels=15, ghost=0.1, read_noise=0.0, electrons=1e9)
    dark, lit = sensor.picture([], 0.0), sensor.picture([(0.0, 0.0)], 5.0)
    places = sensor.hot_at
    assert np.count_nonzero(dark > 40) == len(set(places))
    assert np.all(dark.reshape(-1)[places] > 40) and np.all(lit.reshape(-1)[places] > 40)
    x, y = round(319.5 + sensor.ghost_px[0]), round(239.5 + sensor.ghost_px[1])
    assert lit[y, x] == pytest.approx(14 + 18, abs=1.5)


def test_ambient_light_changes_and_moves():
    sensor = Sensor(ambient_wave=4.0, lamp=10.0)
    early, late = (sensor.picture([], t).astype(float) for t in (0.0, 10.0))
    assert late.mean() - early.mean() > 2
    assert np.argmax(early.mean(axis=0)) != pytest.approx(np.argmax(late.mean(axis=0)), abs=50)


def test_frames_come_thirty_times_a_second_and_later_than_they_are_exposed():
    cam = camera()
    frames = cam.frames()
    seen = []
    for _ in range(20):
        frame = next(frames)
        seen.append((frame.number, frame.time_s, cam.monotonic()))
    numbers, stamps, arrivals = (np.array(x) for x in zip(*seen, strict=True))
    assert list(numbers) == list(range(20))
    assert np.diff(arrivals) == pytest.approx(1 / FRAMES_S, abs=1e-4)
    assert arrivals - stamps == pytest.approx(LATENCY_S, abs=0.006)
    assert not frame.image.flags.writeable


def test_a_reader_that_is_slow_gets_the_newest_frame():
    cam = camera()
    frames = cam.frames()
    next(frames)
    cam.clock.sleep(0.5)
    before = cam.monotonic()
    frame = next(frames)
    assert cam.monotonic() - before < 1 / FRAMES_S
    assert before - frame.time_s < LATENCY_S + 1.5 / FRAMES_S
    assert frame.number > 10


def test_nobody_reads_nothing_is_exposed():
    looks = []
    cam = camera(look=lambda t: looks.append(t) or [])
    next(cam.frames())
    cam.clock.sleep(60.0)
    assert len(looks) < 2 * FRAMES_S
    next(cam.frames())
    assert cam.monotonic() - looks[-1] < 0.2


def test_dropped_and_repeated_frames_are_told():
    cam = camera(timing=Timing(dropped=0.2, repeated=0.2))
    frames = cam.frames()
    seen = [next(frames) for _ in range(300)]
    lost = seen[-1].number - seen[0].number - 299
    assert lost / (299 + lost) == pytest.approx(0.2, abs=0.06)
    assert sum(frame.repeated for frame in seen) / 300 == pytest.approx(0.2, abs=0.06)
    for before, frame in itertools.pairwise(seen):
        assert frame.repeated == np.array_equal(frame.image, before.image)
    for before, frame in itertools.pairwise(seen[10:]):  # by then the period is known
        assert frame.late or frame.number - before.number < 3


def test_each_fault_of_a_camera_shows():
    cam = camera()
    frames = cam.frames()
    first = next(frames)
    cam.frozen = True
    assert next(frames).repeated and np.array_equal(next(frames).image, first.image)
    cam.frozen, cam.black = False, True
    assert not next(frames).image.any()
    cam.black = False
    assert next(frames).image.max() > 100
    cam.more_mm = [(-9.0, 9.0)]
    for _ in range(4):  # those that were exposed before come first
        frame = next(frames)
    x, y = cam.truth_px((-9.0, 9.0))
    assert frame.image[round(y), round(x)] > 150
    cam.plugged = False
    with pytest.raises(CameraGone):
        next(frames)
    cam.plugged = True
    frames = cam.frames()
    assert next(frames).image.max() > 100
    cam.frozen = True
    with pytest.raises(CameraRepeats):
        list(itertools.islice(frames, 40))
    cam.frozen, cam.black = False, True
    with pytest.raises(CameraBlack):
        list(itertools.islice(cam.frames(), 40))


def test_a_camera_that_changes_its_size_is_told():
    cam = camera()
    frames = cam.frames()
    next(frames)
    cam.sensor.resize(320, 240)
    with pytest.raises(CameraSizeChanged):
        next(frames)
    assert next(cam.frames()).image.shape == (240, 320)
    assert cam.size == (320, 240)
