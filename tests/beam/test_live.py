"""A camera that is watched: whatever it does, who looks is told in one line, and its thread goes on."""

import queue
import threading

import cv2
import numpy as np
import pytest

from mirrormount_beam.camera import Controls, Image, Size
from mirrormount_beam.errors import CameraAbsent, CameraBlack, CameraGone, CameraRepeats, CameraSizeChanged, CameraSlow
from mirrormount_beam.live import LiveCamera
from mirrormount_beam.spot.find import NoSpot, Spot

PATIENCE_S = 20.0  # of a busy computer


def picture(size=(64, 48), at=(30, 20)):
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    light = 150 * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * 3.0**2))
    return np.clip(light + np.random.default_rng(1).normal(12, 1, light.shape), 0, 255).astype(np.uint8)


class FakeCamera:
    """A Camera that returns what a test feeds: frames, or what is raised. age_s: of its frames."""

    controls = Controls(True, True)

    def __init__(self):
        self.name = "cam"
        self.size = Size(64, 48)
        self.fed = queue.SimpleQueue()
        self.age_s = 0.0
        self.opened = 0
        self.closed = threading.Event()

    def open(self):
        self.opened += 1
        return self

    def frames(self):
        while (what := self.fed.get()) is not None:
            if isinstance(what, Exception):
                raise what
            yield what

    def monotonic(self):
        return self.age_s

    def close(self):
        self.closed.set()


@pytest.fixture
def camera():
    return FakeCamera()


@pytest.fixture
def live(camera):
    live = LiveCamera("cam", camera.open, retry_s=0.0)
    live.open()
    yield live
    live._closing.set()
    camera.fed.put(None)
    live.close()


def failed(live, camera, error):
    """What is told after the camera has raised that."""
    camera.fed.put(error)
    assert camera.closed.wait(PATIENCE_S)
    return live.trouble


@pytest.mark.parametrize(
    "error",
    [
        CameraGone("cam was unplugged"),
        CameraBlack("cam: all pixels are 0"),
        CameraSlow("cam: 0.2 frames a second"),
        CameraRepeats("cam: 30 frames in a row are the same"),
        CameraSizeChanged("cam: 320 x 240 pixels"),
        OSError("of a driver"),
        ValueError("of a library\nin two lines"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_a_camera_that_fails_is_told_in_one_line_opened_again_and_its_last_picture_stays(live, camera, error):
    camera.fed.put(Image(picture(), 0.0, 0))
    before = live.after(0, PATIENCE_S)
    told = failed(live, camera, error)
    assert told.startswith("cam") and "\n" not in told
    assert live.last is before
    camera.fed.put(Image(picture(), 0.0, 0))
    assert live.after(before.number, PATIENCE_S).number == before.number + 1
    assert live.trouble == ""
    assert camera.opened == 2


def test_a_camera_that_is_not_there_any_more_is_tried_until_it_is(camera):
    absent = [CameraAbsent("cam: cannot be opened")] * 3
    first = camera.open()

    def open_camera():
        if absent:
            raise absent.pop()
        return first

    live = LiveCamera("cam", lambda: first, retry_s=0.0)
    live.open()
    live._open_camera = open_camera
    camera.fed.put(CameraGone("cam was unplugged"))
    camera.fed.put(Image(picture(), 0.0, 0))
    assert live.after(0, PATIENCE_S) and not absent
    live._closing.set()
    camera.fed.put(None)
    live.close()


def test_a_picture_that_is_two_seconds_old_is_not_of_now(live, camera):
    camera.age_s = 5.0
    camera.fed.put(Image(picture(), 0.0, 0))
    live.after(0, PATIENCE_S)
    assert "no new picture for 5 s" in live.trouble


def test_a_repeated_picture_is_as_old_as_the_first_of_its_kind(live, camera):
    camera.fed.put(Image(picture(), 0.0, 0))
    first = live.after(0, PATIENCE_S)
    camera.fed.put(Image(picture(), 0.0, 1, repeated=True))
    camera.fed.put(Image(picture(at=(31, 20)), 0.0, 2))
    assert live.after(first.number, PATIENCE_S).number == first.number + 1


def test_who_waits_for_frames_of_a_camera_in_trouble_is_told_and_not_kept_waiting(live, camera):
    failed(live, camera, CameraGone("cam was unplugged"))
    with pytest.raises(CameraGone):
        next(live.frames())


def test_a_wide_picture_is_made_smaller_for_a_browser_and_is_made_once_for_all_who_look(live, camera):
    camera.fed.put(Image(np.tile(picture((960, 720), (300, 300)), (1, 2)), 0.0, 0))
    seen = live.after(0, PATIENCE_S)
    data = live.jpeg(seen)
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED).shape == (360, 960)
    assert live.jpeg(seen) is data


def test_what_is_found_is_told_with_the_frame(live, camera):
    camera.fed.put(Image(picture(), 0.0, 0))
    with_spot = live.after(0, PATIENCE_S)
    camera.fed.put(Image(picture(at=(900, 900)), 0.0, 1))
    without = live.after(with_spot.number, PATIENCE_S)
    assert isinstance(with_spot.found, Spot) and abs(with_spot.found.x - 30) < 0.2
    assert isinstance(without.found, NoSpot)
