"""Back to a named position by an order of a page, without a browser: what is asked, refused, and what ends it."""

import contextlib
import json
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from desks import order, run, served, ticked
from fastapi import FastAPI
from served import wait_for

from mirrormount.device import presets, records
from mirrormount.errors import BoardError, CannotWrite, NotKept
from mirrormount.supervise.supervisor import Supervisor
from mirrormount_panel.auth import Auth, SignIn
from mirrormount_panel.mounts import Orders, Pages, PanelMount
from mirrormount_panel.page_moves import PageMoves
from mirrormount_panel.positions import Positions
from mirrormount_panel.socket import routes


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "data"))


@pytest.fixture
def desk(board) -> Iterator[SimpleNamespace]:
    """The panel's routes on a board, with one page that is in control and one that watches."""
    with Supervisor(str(board.link), patience_s=30) as supervisor:
        worker = supervisor.worker
        wait_for(lambda: worker.state.status, "the first status")
        ways = PageMoves(worker)
        positions = Positions(worker, ways)
        pages = Pages(worker.lease)
        first, second = pages.add("here"), pages.add("here")
        app = FastAPI()
        orders = Orders({"back": positions.back}, ways.give_way)
        app.include_router(routes([PanelMount("", worker, pages, orders)], None))
        with served(Auth(app, SignIn(None))) as at, ticked(at) as drive, ticked(at) as watch:
            for end, page in ((drive, first), (watch, second)):
                end.send(json.dumps({"page": page.key}))
                end.recv()
            yield SimpleNamespace(
                worker=worker, positions=positions, ways=ways, first=first, second=second, drive=drive, watch=watch
            )


def keep(desk, name: str, x: float, y: float) -> None:
    """Keep a position there, and go away from it: to (0, 0)."""
    for place in ((x, y), (0, 0)):
        for axis, to in zip("xy", place, strict=True):
            ask(desk, do="goto", axis=axis, to=to)
            wait_for(lambda axis=axis, to=to: at_rest(desk) and at(desk)["xy".index(axis)] == to, f"{axis} at {to}")
        if place == (x, y):
            run(desk.positions.keep(name))


def ask(desk, **message) -> None:
    order(desk.worker, desk.drive, **message)


def at(desk) -> list[float]:
    return [axis.position for axis in desk.worker.state.status.by_name.values()]


def at_rest(desk) -> bool:
    return not desk.worker.state.status.moving


def told(desk) -> list[str]:
    return [notice.text for notice in desk.worker.notices]


@contextlib.contextmanager
def a_way(desk) -> Iterator[None]:
    """In the block a way is ordered; after it, it is over."""
    before = desk.ways._last
    yield
    wait_for(lambda: desk.ways._last is not before, "the way")
    wait_for(lambda: not desk.ways._last.thread.is_alive(), "its end", lambda: told(desk))


def asked_by_zero(desk):
    """The question after a Zero."""
    keep(desk, "good", 2, 1)
    ask(desk, do="zero", axis="y")
    wait_for(lambda: desk.worker.state.status.y.certainty == "counted", "Zero")
    ask(desk, do="back", name="good")
    wait_for(lambda: desk.positions.question(desk.first), "the question")
    return desk.positions.question(desk.first)


def test_back_makes_the_moves_of_the_page_one_axis_after_the_other_and_a_part_of_a_step_too(desk, board):
    keep(desk, "good", 3, -1.25)
    before = len(board.edges())
    with a_way(desk):
        ask(desk, do="back", name="good")
    assert told(desk)[-1] == "back at good, by steps" and at(desk) == [3, -1.25]
    pins = [edge["pin"] for edge in board.edges()[before:] if edge.get("duty")]
    assert pins == sorted(pins, reverse=True) and {*pins} == {"m1_en", "m2_en"}  # x is motor 2


def test_where_there_are_doubts_the_page_that_asks_is_asked_and_nothing_moves(desk, board):
    question = asked_by_zero(desk)
    assert question.doubts == ("y: its 0 was set since (Zero), which `mirrormount undo` takes back",)
    assert desk.positions.question(desk.second) is None
    before = board.edges()
    for answer in ({"sure": question.number + 1}, {"sure": True}, {"sure": str(question.number)}, {}):
        asked = desk.positions.question(desk.first)
        ask(desk, do="back", name="good", **answer)
        wait_for(lambda asked=asked: desk.positions.question(desk.first) not in (None, asked), "another question")
    assert board.edges() == before
    ask(desk, do="back", name="good", sure=desk.positions.question(desk.first).number)
    wait_for(lambda: at_rest(desk) and at(desk) == [2, 1], "the position", lambda: told(desk))
    assert desk.positions.question(desk.first) is None


@pytest.mark.parametrize("how", ["late", "kept anew", "other doubts", "another position", "withdrawn"])
def test_an_answer_is_of_that_question_alone(desk, board, how):
    question = asked_by_zero(desk)
    before, name = board.edges(), "good"
    match how:
        case "late":
            desk.worker.lease.patience_s = 0.35
        case "kept anew":
            entry = json.dumps({"boot_id": question.preset.boot_id, "places": {}})
            with records.opened(presets.FILE, "", write=True) as file:
                file.execute("update positions set at = at + 1, entry = ? where name = 'good'", (entry,))
                file.execute("insert into former (board, what, at, entry) values ('', '', 0, '')")
        case "other doubts":
            ask(desk, do="zero", axis="x")
            wait_for(lambda: desk.worker.state.status.x.certainty == "counted", "Zero")
        case "another position":
            with records.opened(presets.FILE, "", write=True) as file:
                file.execute("insert into positions select board, 'other', at, entry from positions")
            name = "other"
        case "withdrawn":
            desk.positions.withdraw(desk.first, question.number)
    if how == "late":
        ask(desk, do="back", name=name, sure=question.number, tick=0)
        wait_for(lambda: any("came late" in text for text in desk.first.notices), "the refusal")
    else:
        with a_way(desk):
            ask(desk, do="back", name=name, sure=question.number)
    assert board.edges() == before


@pytest.mark.parametrize("how", ["stop", "another button", "another page", "the page closes", "undo of a Zero"])
def test_what_ends_the_way_back(desk, board, how):
    keep(desk, "good", 20, 5)
    with a_way(desk):
        ask(desk, do="back", name="good")
        wait_for(lambda: not at_rest(desk) and at(desk)[0] >= 1, "x to move")
        end_it(desk, how)
    wait_for(lambda: at_rest(desk), "rest")
    assert any(text.startswith("the way back to good has ended: ") for text in told(desk))
    if how == "another button":
        wait_for(lambda: at_rest(desk) and at(desk)[1] == -1, "its own step", lambda: told(desk))
    assert at(desk)[0] < 20 and at(desk)[1] <= 0 and desk.positions.doing == ""


def end_it(desk, how: str) -> None:
    match how:
        case "stop":
            ask(desk, do="stop")
        case "another button":
            ask(desk, do="steps", axis="y", way=-1, n="1")
        case "another page":
            order(desk.worker, desk.watch, do="claim")
        case "the page closes":
            desk.drive.close()
        case "undo of a Zero":
            with pytest.raises(NotKept):
                run(desk.positions.undo_zero("x"))


@pytest.mark.parametrize(
    ("message", "why"),
    [
        ({"name": 3}, "a position has a name"),
        ({}, "a position has a name"),
        ({"name": "good", "beam": True}, "this panel has no camera"),
    ],
)
def test_an_order_that_cannot_be_is_refused_in_one_line(desk, message, why):
    ask(desk, do="back", **message)
    wait_for(lambda: desk.first.notices, "the refusal")
    assert why in desk.first.notices[0] and desk.ways._last is None


def test_a_page_that_watches_goes_nowhere_and_a_name_that_is_not_kept_is_told(desk):
    order(desk.worker, desk.watch, do="back", name="good")
    wait_for(lambda: desk.second.notices, "the refusal")
    assert "another page controls" in desk.second.notices[0] and desk.ways._last is None
    with a_way(desk):
        ask(desk, do="back", name="god")
    assert "no position god is kept of this board" in told(desk)[-1]


def test_a_mount_that_moves_is_not_sent_elsewhere(desk):
    keep(desk, "good", 1, 0)
    ask(desk, do="drive", x="0", y="100")
    wait_for(lambda: not at_rest(desk), "the run")
    with a_way(desk):
        ask(desk, do="back", name="good")
    assert "the mount moves" in told(desk)[-1] and at(desk)[0] == 0 and not at_rest(desk)


def test_a_database_that_is_locked_keeps_no_run_from_going_on(desk):
    """It is waited for in another thread: the keep-alive (0.5 s) is fed on."""
    run(desk.positions.keep("good"))
    ask(desk, do="zero", axis="x")
    wait_for(lambda: desk.worker.state.status.x.certainty == "counted", "Zero")
    ask(desk, do="drive", x="0", y="100")
    wait_for(lambda: not at_rest(desk), "the run")
    with records.opened(presets.FILE, presets._SCHEMA, write=True):
        for work in (desk.positions.remove("good"), desk.positions.undo_zero("x")):
            with pytest.raises(CannotWrite, match="locked"):
                run(work)
    assert not at_rest(desk) and not any("says 62" in text for text in told(desk))


def test_keep_and_undo_move_nothing_and_undo_says_what_it_has_done(desk, board):
    ask(desk, do="zero", axis="x")
    wait_for(lambda: desk.worker.state.status.x.certainty == "counted", "Zero")
    assert run(desk.positions.keep("good")) == "good is kept"
    assert "x: the position here is +0 steps as before Zero" in run(desk.positions.undo_zero("x"))
    assert " x: the position here is +0 steps" in desk.positions.done["x"]
    with pytest.raises(NotKept):
        run(desk.positions.undo_zero("x"))
    assert board.edges() == []


def test_an_undo_while_the_axis_moves_undoes_nothing(desk):
    ask(desk, do="zero", axis="y")
    wait_for(lambda: desk.worker.state.status.y.certainty == "counted", "Zero")
    ask(desk, do="drive", x="0", y="100")
    wait_for(lambda: not at_rest(desk), "the run")
    with pytest.raises(BoardError):
        run(desk.positions.undo_zero("y"))
    assert desk.positions._presets().zeroed() == ["y"]
