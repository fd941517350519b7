"""What a loop tells is plain data that survives a log."""

import json

import pytest

from mirrormount_beam.control import events


@pytest.mark.parametrize(
    "event",
    [
        events.Observed(
            1.5,
            (events.SpotSeen("near", (3.0, 4.0), (0.1, 0.2), (10.0, -20.0), 1.4, 2), events.SpotMissed("far", "dark")),
            free_um=((1.0, 2.0),),
        ),
        events.Estimated(1.6, {"near": (9.0, -18.0)}, (1.0, -2.0)),
        events.Pulsed(1.0, "first.x", -12000, events.CREEP),
        events.Corrected(2.0, 1, {"first.x": 0.02}, (1.0, 2.0), (0.0, 0.1), (0.2, 0.3), ("first.x",)),
        events.StateChanged(3.0, events.HOLDING, "within the dead band"),
        events.InterlockTripped(4.0, 1, "no spot", "far: dark", "switch on the laser", True),
        events.InterlockCleared(5.0, 1, "no spot"),
        events.ResponseChanged(6.0, ((1.0, 2.0), (3.0, 4.0)), 0.01),
        events.Progress(7.0, 0.5, "first.x"),
    ],
    ids=lambda event: type(event).__name__,
)
def test_an_event_is_the_same_after_a_line_of_json(event):
    assert events.from_json(json.loads(json.dumps(events.to_json(event)))) == event


def test_the_worst_error_of_a_look_is_over_all_cameras_and_axes():
    near = events.SpotSeen("near", (0, 0), (0, 0), (10.0, -30.0), 0.0)
    far = events.SpotSeen("far", (0, 0), (0, 0), (20.0, 5.0), 0.0)
    assert events.Observed(0.0, (near, far)).worst_um == 30.0
