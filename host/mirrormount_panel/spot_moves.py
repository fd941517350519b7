"""Clicks on the picture: the spot is moved there, on behalf of the page that clicked.

The moves are requests of that page to the worker, so that control, STOP, its ticks and the board's keep-alive hold for
them as for its buttons. They are announced a second before they begin. Any other request of a person ends them.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import TimeoutError as NotYet
from typing import Any

from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue, MountError, MoveEnded, NoAnswer, NotInControl
from mirrormount.supervise.lease import Client
from mirrormount.supervise.motions import Motion
from mirrormount.supervise.requests import Pulse, Request, Steps
from mirrormount.supervise.worker import Worker
from mirrormount.values import typed_number
from mirrormount_beam.live import LiveCamera
from mirrormount_beam.observe import Sighting, SpotObserver
from mirrormount_beam.pointing import CORRECTIONS, GAP_STEPS, LEARN_STEPS, WITHIN_PX, Learned, approach, learn
from mirrormount_panel.camera import CameraView

ANNOUNCED_S = 1.0  # A move is announced so long before the first motor runs.
_CHECK_S = 0.05  # The time between two checks whether the move was ended.
_MOTION_S = 30.0  # One correction takes at most so long.
_ANSWER_S = 5.0
_UNKNOWN = (
    "nothing was done: it is not known how a step moves the spot; press Learn first"
    f" ({1 + LEARN_STEPS} to {GAP_STEPS + LEARN_STEPS} steps of each axis)"
)

_log = logging.getLogger("mirrormount_panel")
_Board = tuple[object, ...]  # board, camera, size, and what a step of each axis is: the response is of these


class SpotMoves:
    """The moves of the spot in one camera, one at a time. For the panel's asyncio loop."""

    def __init__(self, worker: Worker, view: CameraView[LiveCamera], announced_s: float = ANNOUNCED_S) -> None:
        self._worker = worker
        self._view = view
        self._announced_s = announced_s
        self._learned: tuple[_Board, Learned] | None = None
        self._move: _Move | None = None

    def place(self, page: Client, message: Mapping[str, Any]) -> None:
        """Move the spot to a place in the picture. Raises BadValue."""
        self._check_camera(message)
        size = self._view.live.size
        if (message.get("width", size.width), message.get("height", size.height)) != size:
            raise BadValue("the picture has another size by now: click again")
        x, y = _number(message, "x", size.width), _number(message, "y", size.height)
        if self._learned is None:
            raise BadValue(_UNKNOWN.removeprefix("nothing was done: "))
        self._begin(page, lambda move: self._place(move, (x, y)))

    def learn(self, page: Client, message: Mapping[str, Any]) -> None:
        """Measure what a step of each axis does to the spot. Raises BadValue."""
        self._check_camera(message)
        self._begin(page, self._learn)

    def give_way(self) -> None:
        """A person asks for something else: what goes on here ends."""
        if self._move:
            self._move.end("something else was asked for")

    def close(self) -> None:
        """End what goes on."""
        if self._move:
            self._move.end("the panel is being ended")
            self._move.thread.join(5)

    def _check_camera(self, message: Mapping[str, Any]) -> None:
        if str(message.get("camera", "1")) != "1":
            raise BadValue("there is no such camera")
        if self._view.live.trouble:
            raise BadValue(f"the picture is not of now: {self._view.live.trouble}")

    def _begin(self, page: Client, work: "Callable[[_Move], str]") -> None:
        before = self._move
        self.give_way()
        self._move = _Move(self._worker, self._view, page, before.thread if before else None, work)
        self._move.thread.start()

    # ---- in the move's own thread

    def _place(self, move: "_Move", target: tuple[float, float]) -> str:
        learned = self._learned
        if learned is None or learned[0] != move.board():
            self._learned = None
            raise BadValue("another board, camera or length of a step: press Learn again")
        self._view.target = target
        start = move.observe(1)
        ways = zip(learned[1].axes, learned[1].steps(target[0] - start.x, target[1] - start.y), strict=True)
        steps = " and ".join(f"{way:+.1f} steps of {axis}" for axis, way in ways).replace("-", "−")
        where = f"({target[0]:.0f}, {target[1]:.0f}) px"
        move.announce(f"the spot goes to {where}, about {steps}, in at most {CORRECTIONS} moves", self._announced_s)
        arrival = approach(move, learned[1], target, move.say)
        if arrival.reached:
            return f"the spot is at {where}, within {WITHIN_PX:g} px, after {arrival.corrections} moves"
        return f"the spot is {arrival.off_px:.1f} px off {where} after {arrival.corrections} moves: click again"

    def _learn(self, move: "_Move") -> str:
        self._view.target = None
        x, y, *_ = self._worker.state.axes
        most = GAP_STEPS + LEARN_STEPS
        move.announce(f"Learn: {1 + LEARN_STEPS} to {most} steps of {x}, then of {y}", self._announced_s)
        board = move.board()
        found = learn(move, (x, y), move.say)
        self._learned = board, found
        (a, b), (c, d) = found.px
        lengths = f"{math.hypot(a, c):.1f} and {math.hypot(b, d):.1f} px"
        return f"a step of {x} and of {y} moves the spot by {lengths}: now click where it should go"


class _Move:
    """One move, as pointing.Hands. Everything raises NotInControl as soon as it was ended, by whomever."""

    def __init__(
        self,
        worker: Worker,
        view: CameraView[LiveCamera],
        page: Client,
        before: threading.Thread | None,
        work: Callable[["_Move"], str],
    ) -> None:
        self._worker = worker
        self._view = view
        self._page = page
        self._stops = worker.lease.stops  # from here on any stop ends it
        self._before = before
        self._work = work
        self._ended = ""
        self._over = threading.Event()  # set by end()
        self._lock = threading.Lock()  # no request is made after end()
        self._observer = SpotObserver(view.live, view.live.found)
        self._step_us: dict[str, int] = {}
        self.thread = threading.Thread(target=self._run, name="moves the spot", daemon=True)

    def end(self, why: str) -> None:
        """Ask for no further motion. Any thread."""
        with self._lock:
            self._ended = self._ended or why
            self._over.set()

    def _run(self) -> None:
        if self._before:
            self._before.join()
        try:
            told = self._work(self)
        except (NotInControl, MoveEnded) as e:
            told = f"the move of the spot has ended: {self._why() or e}"
        except MountError as e:
            told = f"the spot is not moved: {e}"
        except Exception as e:
            _log.exception("a move of the spot has failed")
            told = f"the move of the spot has failed ({type(e).__name__})"
        self._view.doing = ""
        self._worker.report(told)

    def _why(self) -> str:
        if self._worker.lease.stops != self._stops:
            return f"stopped: {self._worker.stop_cause}"
        return self._ended or ("" if self._worker.lease.alive(self._page) else f"{self._page.name} is out of touch")

    def _check(self) -> None:
        why = self._why()
        if why:
            raise NotInControl(why)

    def announce(self, text: str, for_s: float) -> None:
        """Tell it, and wait."""
        self._worker.report(f"{self._page.name}: {text}; STOP ends it")
        self.say(f"{text}; STOP ends it")
        until_s = time.monotonic() + for_s
        while time.monotonic() < until_s:
            self._check()
            self._over.wait(_CHECK_S)  # a stop, or a page that is out of touch, is seen by _check()

    def say(self, text: str) -> None:
        """What it does, in a line."""
        self._check()
        self._view.doing = text

    def board(self) -> _Board:
        """What a response is of."""

        def ask(mount: Mount) -> _Board:
            axes = tuple(mount.by_name)[:2]
            steps = [mount.axis(axis).ask_whole("XP?", "XD?", "XI?") for axis in axes]
            self._step_us = {axis: step[0] for axis, step in zip(axes, steps, strict=True)}
            return mount.board_id, *axes, *map(tuple, steps)

        try:
            board = self._worker.call(ask).result(_ANSWER_S)
        except NotYet:
            raise NoAnswer("the board was busy for too long; ask again") from None
        return *board, self._view.live.name, *self._view.live.size

    # ---- pointing.Hands

    def step_us(self, axis: str) -> int:
        """The length of one step's pulse."""
        return self._step_us[axis]

    def step(self, axis: str, n: int) -> None:
        """Move by n steps. Raises NotInControl, MoveEnded, MountError."""
        self._ask(Steps(axis, n), axis, n)

    def pulse(self, axis: str, us: int) -> None:
        """Give one pulse. Raises as step()."""
        self._ask(Pulse(axis, us), axis, None)

    def observe(self, frames: int) -> Sighting:
        """Where the spot is. Raises NotInControl, SpotLost, CameraError."""
        self._check()
        sighting = self._observer.observe(frames)
        self._check()
        return sighting

    def _ask(self, request: Request, axis: str, wanted: int | None) -> None:
        motion = Motion(axis, wanted, lambda: None, _CHECK_S, jog=False)
        with self._lock:
            self._check()
            self._worker.request(self._page, request, motion, stops=self._stops)
        try:
            motion.wait(_MOTION_S)
        except TimeoutError:
            self._worker.stop("a move of the spot was not over in time")
            raise NotInControl(f"{axis}: not over within {_MOTION_S:g} s") from None


def _number(message: Mapping[str, Any], key: str, below: int) -> float:
    """A coordinate in the picture, as a number or as it was typed. Raises BadValue."""
    value = message.get(key)
    if isinstance(value, str):
        try:
            value = typed_number(value.strip(), key) if len(value) < 20 else None
        except BadValue:
            value = None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= below - 1:
        raise BadValue(f"{key} is a number from 0 to {below - 1}, in the picture")
    return float(value)
