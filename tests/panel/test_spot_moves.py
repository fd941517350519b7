"""Clicks on the picture of a virtual table's camera, without a browser: what is refused, what ends a move, who sees."""

import json
import math
from collections.abc import Iterator
from types import SimpleNamespace

import httpx
import pytest
from desks import order, run, served, ticked
from fastapi import FastAPI
from served import wait_for

from mirrormount.supervise.supervisor import Supervisor
from mirrormount_beam.live import LiveCamera
from mirrormount_beam.pointing import Learned
from mirrormount_panel import camera as camera_module
from mirrormount_panel.auth import Auth, SignIn
from mirrormount_panel.camera import CameraView
from mirrormount_panel.mounts import Orders, Pages, PanelMount
from mirrormount_panel.page_moves import PageMoves
from mirrormount_panel.positions import Positions
from mirrormount_panel.socket import routes
from mirrormount_panel.spot_moves import SpotMoves
from mirrormount_sim.table import open_table


@pytest.fixture(scope="module")
def bench() -> Iterator[SimpleNamespace]:
    """A virtual table with its mount supervised, and its camera watched; one for all tests."""
    with open_table("virtual-table://?mounts=1&speed=1") as table:
        camera = table.cameras[1]
        live = LiveCamera(camera.name, lambda: camera, retry_s=0.05)
        live.open()
        with Supervisor(lambda: table.ports[0], patience_s=30) as supervisor:
            wait_for(lambda: supervisor.status, "the first status")
            yield SimpleNamespace(table=table, camera=camera, live=live, worker=supervisor.worker)
        live.close()


@pytest.fixture
def desk(bench) -> Iterator[SimpleNamespace]:
    """The panel's routes, with one page that is in control and one that watches."""
    bench.worker.notices = type(bench.worker.notices)()
    view = CameraView(bench.live)
    ways = PageMoves(bench.worker)
    moves = SpotMoves(bench.worker, view, ways, announced_s=0.2)
    positions = Positions(bench.worker, ways, moves)
    pages = Pages(bench.worker.lease)
    first, second = pages.add("here"), pages.add("here")
    app = FastAPI()
    orders = Orders({"place": moves.place, "learn": moves.learn, "back": positions.back}, ways.give_way)
    app.include_router(routes([PanelMount("", bench.worker, pages, orders)], None))
    named = {first.key: "first"}
    app.include_router(camera_module.routes([view], lambda request: named.get(request.headers.get("x-page"))))
    with served(Auth(app, SignIn(None))) as at, ticked(at) as drive, ticked(at) as watch:
        for end, page in ((drive, first), (watch, second)):
            end.send(json.dumps({"page": page.key}))
            end.recv()
        wait_for(lambda: not bench.live.trouble, "a picture")
        with httpx.Client(base_url=f"http://{at}") as http:
            yield SimpleNamespace(
                drive=drive,
                watch=watch,
                first=first,
                second=second,
                view=view,
                moves=moves,
                ways=ways,
                positions=positions,
                http=http,
            )
        if ways._last:
            ways._last.thread.join(20)  # it has ended with its page


def ask(bench, end, **message) -> None:
    order(bench.worker, end, **message)


def told(bench) -> list[str]:
    return [notice.text for notice in bench.worker.notices]


def turned(bench) -> list[float]:
    return [axis.position for axis in bench.worker.state.status.by_name.values()]


def learned(bench, desk) -> None:
    """As after Learn, which a test of its own does."""
    ask(bench, desk.drive, do="learn")
    wait_for(lambda: any("now click where" in text for text in told(bench)), "the end of Learn")


CLICK = {"do": "place", "camera": "1", "x": 300, "y": 200}


@pytest.mark.parametrize(
    ("message", "why"),
    [
        ({}, "press Learn first (3 to 8 steps of each axis)"),
        ({"x": -1}, "x is a number from 0 to 639"),
        ({"x": 639.5}, "x is a number from 0 to 639"),
        ({"y": 480}, "y is a number from 0 to 479"),
        ({"y": math.nan}, "y is a number from 0 to 479"),
        ({"x": math.inf}, "x is a number"),
        ({"x": "1e999"}, "x is a number"),
        ({"x": "left"}, "x is a number"),
        ({"x": True}, "x is a number"),
        ({"x": None}, "x is a number"),
        ({"x": [1]}, "x is a number"),
        ({"camera": "2"}, "there is no such camera"),
        ({"width": 320, "height": 240}, "the picture has another size by now"),
        ({"tick": 0}, "that came late"),
    ],
)
def test_a_click_that_cannot_be_carried_out_is_refused_in_one_line_and_moves_nothing(bench, desk, message, why):
    before = turned(bench)
    ask(bench, desk.drive, **{**CLICK, **message})
    wait_for(lambda: desk.first.notices, "the refusal")
    assert why in desk.first.notices[0] and "\n" not in desk.first.notices[0]
    assert desk.ways._last is None and turned(bench) == before


def test_a_page_that_watches_moves_no_spot(bench, desk):
    ask(bench, desk.watch, do="learn")
    wait_for(lambda: desk.second.notices, "the refusal")
    assert "another page controls" in desk.second.notices[0]
    assert desk.ways._last is None


def test_a_click_on_a_picture_that_is_not_of_now_is_refused(bench, desk):
    bench.camera.plugged = False
    try:
        wait_for(lambda: bench.live.trouble, "the camera to be gone")
        ask(bench, desk.drive, **CLICK)
        wait_for(lambda: desk.first.notices, "the refusal")
    finally:
        bench.camera.plugged = True
    assert "the picture is not of now: virtual camera 2 was unplugged" in desk.first.notices[0]


@pytest.mark.wall_clock  # some steps, each with pictures after it, in real time
def test_learn_then_a_click_and_the_spot_is_there(bench, desk):
    learned(bench, desk)
    ask(bench, desk.drive, **CLICK)
    wait_for(lambda: any("the spot is " in text for text in told(bench)), "the end", lambda: told(bench))
    announced = next(text for text in told(bench) if "the spot goes to" in text)
    assert "about" in announced and "STOP ends it" in announced
    assert "within 0.5 px" in told(bench)[-1]
    spot = bench.live.after(bench.live.last.number, 20).found
    assert math.dist((spot.x, spot.y), (300, 200)) < 1.0


def test_a_stop_after_the_announcement_lets_no_motor_run(bench, desk):
    board = desk.moves
    board._announced_s = 30.0
    before = turned(bench)
    ask(bench, desk.drive, do="learn")
    wait_for(lambda: "STOP ends it" in desk.view.doing, "the announcement")
    ask(bench, desk.drive, do="stop")
    wait_for(lambda: any("the move of the spot has ended: stopped: STOP was pressed" in t for t in told(bench)), "it")
    assert turned(bench) == before


@pytest.mark.parametrize("how", ["stop", "another button", "another page", "the page closes"])
def test_what_ends_a_move_of_the_spot_in_its_middle(bench, desk, how):
    ask(bench, desk.drive, do="learn")
    wait_for(lambda: "step 1 of" in desk.view.doing, "the first step")
    match how:
        case "stop":
            ask(bench, desk.drive, do="stop")
        case "another button":
            ask(bench, desk.drive, do="steps", axis="y", way=1, n="1")
        case "another page":
            ask(bench, desk.watch, do="claim")
        case "the page closes":
            desk.drive.close()
    desk.ways._last.thread.join(20)
    assert any("the move of the spot has ended" in text for text in told(bench))
    assert desk.view.doing == ""


def test_by_the_beam_without_learn_is_refused_before_anything_moves(bench, desk):
    assert run(desk.positions.keep("unlearned")) == "unlearned is kept with its spot"
    before = turned(bench)
    ask(bench, desk.drive, do="back", name="unlearned", beam=True)
    wait_for(lambda: any("press Learn first" in text for text in told(bench)), "the refusal")
    assert turned(bench) == before


@pytest.mark.wall_clock  # some steps, each with pictures after it, in real time
def test_back_by_the_beam_brings_the_spot_to_where_it_was_kept(bench, desk):
    learned(bench, desk)
    spot = desk.moves.seen()
    run(desk.positions.keep("good"))
    for way, n in ((-1, "5"), (1, "2")):  # away, and back by the steps of the other side
        for axis in ("x", "y"):
            to = turned(bench)["xy".index(axis)] + way * int(n)
            ask(bench, desk.drive, do="steps", axis=axis, way=way, n=n)
            wait_for(lambda axis=axis, to=to: abs(turned(bench)["xy".index(axis)] - to) < 0.1, f"{n} of {axis}")
            wait_for(lambda: not bench.worker.state.status.moving, "rest")
    ask(bench, desk.drive, do="back", name="good", beam=True)
    wait_for(lambda: any("back at good" in text for text in told(bench)), "the end", lambda: told(bench))
    assert "px from where it was kept" in told(bench)[-1]
    now = desk.moves.seen()
    assert math.dist((now.x, now.y), (spot.x, spot.y)) < 1.0


def test_a_response_of_another_length_of_a_step_is_not_used(bench, desk):
    desk.moves._learned = ("another board",), Learned(("x", "y"), ((1.0, 0.0), (0.0, 1.0)))
    before = turned(bench)
    ask(bench, desk.drive, **CLICK)
    wait_for(lambda: any("press Learn again" in text for text in told(bench)), "the refusal")
    assert turned(bench) == before


def test_a_request_that_was_decided_before_a_stop_is_not_begun_after_it(bench, desk):
    from mirrormount.supervise.motions import Motion
    from mirrormount.supervise.requests import Steps

    before, stops = turned(bench), bench.worker.lease.stops
    bench.worker.stop("a test")
    motion = Motion("x", 3, lambda: None, 0.1, jog=False)
    bench.worker.request(desk.first, Steps("x", 3), motion, stops=stops)
    assert "stopped before it began" in str(motion.future.exception(20))
    assert turned(bench) == before


# ---- the pictures


def test_a_picture_comes_with_what_is_seen_in_it_and_only_if_it_is_new(bench, desk):
    answer = desk.http.get("/camera/1?after=0&profile", headers={"x-page": desk.first.key})
    seen = json.loads(answer.headers["x-seen"])
    assert answer.content[:2] == b"\xff\xd8" and seen["size"] == [640, 480]
    assert seen["says"].startswith("x ") and "threshold" in seen["also"] and len(seen["profile"]["light"]) == 160
    later = desk.http.get("/camera/1?after=999999999", headers={"x-page": desk.first.key})
    assert later.status_code == 204 and "x-seen" in later.headers


@pytest.mark.parametrize(
    ("path", "page", "status"),
    [
        ("/camera/1", None, 403),
        ("/camera/1", "guessed", 403),
        ("/camera/2", "own", 404),
        ("/camera/0", "own", 404),
        ("/camera/1/2", "own", 404),
        ("/camera/../stop", "own", 405),
        ("/camera/1?after=-1", "own", 200),
        ("/camera/1?after=99999999999999999999999", "own", 200),
    ],
)
def test_who_asks_for_what_is_not_there_gets_no_picture(desk, path, page, status):
    headers = {} if page is None else {"x-page": desk.first.key if page == "own" else page}
    assert desk.http.get(path, headers=headers).status_code == status


def test_a_page_that_asks_too_often_gets_no_queue(desk):
    answers = [desk.http.get("/camera/1", headers={"x-page": desk.first.key}).status_code for _ in range(40)]
    assert 429 in answers and 200 in answers


def test_a_page_of_another_site_sees_no_picture(desk):
    headers = {"x-page": desk.first.key, "origin": "http://elsewhere.example"}
    assert desk.http.get("/camera/1", headers=headers).status_code == 403
