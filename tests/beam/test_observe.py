"""What is a place of the spot, and what is none: fresh frames of one camera, with the patience of both users."""

import itertools

import numpy as np
import pytest

from mirrormount_beam.camera import Image, Size
from mirrormount_beam.errors import CameraError, CameraGone, CameraRepeats, SpotLost
from mirrormount_beam.observe import OF_LOOP, OF_MEASUREMENT, Fault, SpotObserver
from mirrormount_beam.spot.find import NoSpot, NoSpotReason, Spot

LIGHT, BLACK = np.array([[0, 9]], np.uint8), np.zeros((1, 2), np.uint8)
SETTLE_S = 0.1


class Camera:
    """Its clock goes on by 0.05 s a frame; each frame is made by the test, of its time."""

    name, size = "cam", Size(2, 1)

    def __init__(self, make):
        self.now_s, self.make = 0.0, make

    def monotonic(self):
        return self.now_s

    def frames(self):
        for number in itertools.count():
            self.now_s += 0.05
            frame = self.make(number, self.now_s)
            if frame is None:
                return
            yield frame


def at(frame):
    """The number of the frame is the spot's x."""
    if not frame.image.max():
        return NoSpot(NoSpotReason.FLAT)
    return Spot(float(frame.number), 5.0, 0.3, 0.4, 12.0, 12.0, 180.0, 0.0, 0, 600.0)


def observer(make, patience=OF_MEASUREMENT):
    return SpotObserver(Camera(make), at, patience, settle_s=SETTLE_S)


def test_a_place_is_the_mean_of_settled_frames_with_the_larger_one_of_both_errors():
    seen = observer(lambda number, s: Image(LIGHT, s, number, repeated=number % 2 == 1)).observe(3)
    assert (seen.x, seen.y, seen.frames) == (4.0, 5.0, 3), "frames 2, 4 and 6: earlier ones are of the motion"
    assert seen.error_x == pytest.approx(2 / 3**0.5) and seen.error_y == pytest.approx(0.4 / 3**0.5)
    assert seen.time_s == pytest.approx(0.35)


@pytest.mark.parametrize("patience", [OF_MEASUREMENT, OF_LOOP], ids=["measurement", "loop"])
@pytest.mark.parametrize(
    ("make", "kind", "error"),
    [
        (lambda number, s: Image(LIGHT, s, number, repeated=number > 4), "repeats", CameraRepeats),
        (lambda number, s: Image(BLACK, s, number, repeated=True), "spot", SpotLost),
        (lambda number, s: Image(BLACK, s, number), "spot", SpotLost),
        (lambda number, s: Image(LIGHT, -9.0, number), "old", CameraError),
        (lambda number, s: Image(LIGHT, s, number) if number < 4 else None, "gone", CameraGone),
    ],
    ids=["repeats", "dark, and repeats", "dark", "before the motion", "gone"],
)
def test_frames_of_no_use_end_it_with_their_reason(make, kind, error, patience):
    watched = observer(make, patience)
    with pytest.raises(error, match="cam"):
        watched.observe(9)
    watched = observer(make, patience)
    watched.moved()
    fault = watched.mean(9)
    assert isinstance(fault, Fault) and fault.kind == kind


def test_only_the_loop_minds_frames_that_come_late():
    def late(number, s):
        return Image(LIGHT, s - 2.0, number)

    assert observer(late).mean(2).frames == 2
    assert observer(late, OF_LOOP).mean(2).kind == "old"
