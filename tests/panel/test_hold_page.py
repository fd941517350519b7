"""The page of a loop, without a browser: what its board tells, what HOLD and STOP need, what pages see."""

import time

import httpx
import numpy as np
import pytest
from test_spot_moves import served

from mirrormount.errors import NotInControl
from mirrormount_beam.camera import Image, Size
from mirrormount_beam.control import events
from mirrormount_beam.errors import CameraGone
from mirrormount_beam.table import TargetCamera
from mirrormount_panel.auth import SignIn
from mirrormount_panel.hold_page import ALARM, CALM, WARN, HoldBoard, make_hold_server

TOKEN = b"kKq3-0d7LbX_u2mTzR9sWg"
SPOT = events.SpotSeen("far", (320.0, 240.0), (0.1, 0.2), (12.0, -5.0), 1.0)


class OnePicture:
    """A camera that shows one picture, and then has gone."""

    size = Size(64, 48)

    def monotonic(self):
        return 0.0

    def frames(self):
        yield Image(np.random.default_rng(1).integers(0, 20, (48, 64)).astype(np.uint8), 0.0, 0)
        raise CameraGone("far was unplugged")


def far_camera():
    """That camera on a table; the loop has found no spot in its picture. And the frames that come then."""
    camera = TargetCamera("far", OnePicture(), (30.0, 20.0), (50.0, 50.0), 1.6)
    frames = camera.frames()
    camera.find(next(frames))
    return camera, frames


def gate(number=1, *, clears_itself):
    return events.InterlockTripped(1.0, number, "no spot", "far: dark", "switch the laser on", clears_itself)


@pytest.mark.parametrize(
    ("told", "alert"),
    [
        ([], CALM),
        ([events.StateChanged(1.0, events.HOLDING)], CALM),
        ([gate(clears_itself=True), events.StateChanged(1.0, events.WAITING)], WARN),
        ([gate(clears_itself=False), events.StateChanged(1.0, events.WAITING)], ALARM),
        ([events.StateChanged(1.0, events.STOPPED, "STOP was pressed")], ALARM),
        (
            [gate(clears_itself=True), events.InterlockCleared(2.0, 1, "no spot"), events.StateChanged(2.0, "holding")],
            CALM,
        ),
        ([gate(1, clears_itself=True), gate(2, clears_itself=False)], ALARM),
        ([gate(1, clears_itself=True), gate(2, clears_itself=False), events.InterlockCleared(2.0, 2, "no spot")], CALM),
        ([events.StateChanged(1.0, events.ENDED, "its time is over")], CALM),
    ],
)
def test_an_alarm_is_what_a_person_has_to_act_on(told, alert):
    board = HoldBoard()
    for event in told:
        board.listen(event)
    assert board.alert == alert == board.told()["alert"]


def test_the_board_tells_errors_with_their_standard_errors_and_what_would_be_without_the_loop():
    board = HoldBoard({"far": (50.0, 40.0)})
    board.listen(events.Observed(1.0, (SPOT, events.SpotMissed("near", "dark")), None, ((30.0, 40.0),)))
    far, near = board.told()["cameras"]
    assert far == {"name": "far", "off": [12.0, -5.0], "sigma": [5.0, 8.0], "free": [30.0, 40.0]}
    assert near == {"name": "near", "missed": "dark", "free": None}


def test_the_rms_is_over_the_time_of_the_last_minute_less_that_behind_a_gate():
    board = HoldBoard()
    for time_s, um in ((0.0, 1000.0), (10.0, 12.0), (11.0, 3000.0)):
        board.listen(events.Estimated(time_s, {"far": (um, 5.0)}, (um, 0.0)))
    board.listen(gate(clears_itself=True))
    for time_s in (68.0, 71.0):
        board.listen(events.Observed(time_s, (SPOT,)))  # what was held until 10 s is out
        board.listen(events.Estimated(time_s, {"far": (4.0, -8.0)}, (-3.0, 4.0)))
    um, urad = ((part + 3 * later) / 4 for part, later in ((12.0**2, 8.0**2), (12.0**2, 3.0**2)))
    assert board.told()["rms"] == {"um": round(um**0.5, 1), "urad": round(urad**0.5, 1)}


def test_the_history_is_bounded_and_told_once():
    board = HoldBoard()
    for number in range(5000):
        board.listen(events.Observed(number * 0.5, (SPOT,)))
    assert len(board.told()["history"]) == 1200
    assert [point["t"] for point in board.told(2498.5)["history"]] == [2499.0, 2499.5]


def test_a_board_of_a_loop_that_has_seen_nothing_is_plain_json():
    board = HoldBoard()
    board.listen(events.Observed(1.0, (events.SpotMissed("far", "dark"),)))
    assert board.told()["rms"] == {"um": None, "urad": None}


def test_a_camera_that_has_gone_is_told_to_pages_and_to_the_loop():
    camera, frames = far_camera()
    view = camera.view
    assert view.trouble == "" and view.last.number == 1
    with pytest.raises(CameraGone):
        next(frames)
    assert view.trouble == "far was unplugged" and view.last.number == 1


@pytest.fixture(params=[None, TOKEN], ids=["loopback", "token"])
def page(request):
    """The served page: (client, what was asked, headers of a signed-in page)."""
    asked, sign_in = [], SignIn(request.param)
    camera, _ = far_camera()
    server = make_hold_server(
        [camera], HoldBoard(), sign_in, go=lambda: asked.append("go"), stop=lambda: asked.append("stop")
    )
    cookies = {sign_in.cookie_name: sign_in.cookie.decode()} if request.param else {}
    with (
        served(server.config.app) as at,
        httpx.Client(base_url=f"http://{at}", cookies=cookies) as http,
    ):
        yield http, asked, {"x-key": sign_in.key or ""}


def test_hold_takes_a_fresh_tick_and_nothing_else(page):
    http, asked, key = page
    tick = http.get("/hold/state", headers=key).json()["tick"]
    for body in (b"", b"now", b"-1", b"1" * 16, b"9" * 200, str(tick + 60_000).encode(), str(tick - 2001).encode()):
        assert http.post("/hold/go", content=body, headers=key).status_code in (400, 409)
    assert asked == []
    assert http.post("/hold/go", content=str(tick).encode(), headers=key).status_code == 204
    assert asked == ["go"]


def test_the_cookie_alone_holds_nothing_sees_nothing_and_stops(page):
    http, asked, key = page
    if not key["x-key"]:
        key = {"x-key": "", "origin": "http://elsewhere.example"}  # without a token: another site
        assert http.post("/stop", headers=key).status_code == 403
    else:
        assert http.post("/stop").status_code == 204
        assert asked.pop() == "stop"
        key = {"x-key": "guessed"}
    tick = int(time.monotonic() * 1000)
    assert http.post("/hold/go", content=str(tick).encode(), headers=key).status_code == 403
    assert http.get("/hold/state", headers=key).status_code == 403
    assert http.get("/camera/1", headers=key).status_code == 403
    assert asked == []


def test_the_page_has_a_picture_for_each_camera_with_its_target(page):
    http, _, key = page
    assert 'data-camera="1"' in http.get("/").text
    seen = http.get("/camera/1", headers=key).headers["x-seen"]
    assert '"target":[30.0,20.0]' in seen and "no spot" in seen


def test_a_refusal_of_the_loop_is_told_in_its_own_words():
    def go():
        raise NotInControl("nothing was done: page 1 has control")

    clock = [1.0]
    server = make_hold_server([], HoldBoard(), SignIn(None), go=go, stop=lambda: None, clock=lambda: clock[0])
    with served(server.config.app) as at:
        answer = httpx.post(f"http://{at}/hold/go", content=b"1000")
        assert answer.status_code == 409 and "page 1 has control" in answer.text
        clock[0] = 4.0
        assert "that came late" in httpx.post(f"http://{at}/hold/go", content=b"1000").text
