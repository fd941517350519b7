"""Clicks on the picture: the spot is moved there, on behalf of the page that clicked (page_moves.py).

A move is announced a second before it begins.
"""

import math
from collections.abc import Mapping
from typing import Any

from mirrormount.device.mount import Mount
from mirrormount.device.presets import SeenSpot
from mirrormount.errors import BadValue
from mirrormount.supervise.lease import Client
from mirrormount.supervise.requests import Pulse, Steps
from mirrormount.supervise.worker import Worker
from mirrormount.values import typed_number
from mirrormount_beam import kept
from mirrormount_beam.live import LiveCamera
from mirrormount_beam.observe import Sighting, SpotObserver
from mirrormount_beam.pointing import (
    CORRECTIONS,
    GAP_STEPS,
    LEARN_STEPS,
    WITHIN_PX,
    Arrival,
    Learned,
    approach,
    learn,
)
from mirrormount_panel.camera import CameraView
from mirrormount_panel.page_moves import PageMove, PageMoves

ANNOUNCED_S = 1.0  # A move is announced so long before the first motor runs.
_MOTION_S = 30.0  # One correction takes at most so long.
_WHAT = "the move of the spot"
_UNKNOWN = (
    "it is not known how a step moves the spot; press Learn first"
    f" ({1 + LEARN_STEPS} to {GAP_STEPS + LEARN_STEPS} steps of each axis)"
)

_Board = tuple[object, ...]  # board, camera, size, and what a step of each axis is: the response is of these


class SpotMoves:
    """The moves of the spot in one camera, among the ways of its mount. For the panel's asyncio loop."""

    def __init__(
        self, worker: Worker, view: CameraView[LiveCamera], moves: PageMoves, announced_s: float = ANNOUNCED_S
    ) -> None:
        self._worker = worker
        self._view = view
        self._moves = moves
        self._announced_s = announced_s
        self._learned: tuple[_Board, Learned] | None = None

    def place(self, page: Client, message: Mapping[str, Any]) -> None:
        """Move the spot to a place in the picture. Raises BadValue."""
        self._check_camera(message)
        size = self._view.live.size
        if (message.get("width", size.width), message.get("height", size.height)) != size:
            raise BadValue("the picture has another size by now: click again")
        x, y = _number(message, "x", size.width), _number(message, "y", size.height)
        if self._learned is None:
            raise BadValue(_UNKNOWN)
        self._moves.begin(page, _WHAT, lambda move: self._place(move, (x, y)), self._say)

    def learn(self, page: Client, message: Mapping[str, Any]) -> None:
        """Measure what a step of each axis does to the spot. Raises BadValue."""
        self._check_camera(message)
        self._moves.begin(page, _WHAT, self._learn, self._say)

    def check(self, name: str, spot: SeenSpot | None) -> SeenSpot:
        """The spot of a kept position, if it can be brought there. Raises BadValue, CannotCompare."""
        self._check_camera({})
        spot = kept.comparable(name, spot, self._view.live)
        if self._learned is None:
            raise BadValue(_UNKNOWN)
        return spot

    def _say(self, text: str) -> None:
        self._view.doing = text

    def _check_camera(self, message: Mapping[str, Any]) -> None:
        if str(message.get("camera", "1")) != "1":
            raise BadValue("there is no such camera")
        if self._view.live.trouble:
            raise BadValue(f"the picture is not of now: {self._view.live.trouble}; wait for the next one")

    # ---- in another thread

    def seen(self) -> SeenSpot:
        """Where the spot is now. Raises SpotLost, CameraError."""
        return kept.seen(SpotObserver(self._view.live, self._view.live.found))

    def bring(self, move: PageMove, spot: SeenSpot) -> Arrival:
        """Move the spot from where it is to a place, on another way. Raises as approach(), BadValue."""
        hands = _Hands(move, self._view)
        return self._approach(hands, self._known(hands), (spot.x, spot.y))

    def _place(self, move: PageMove, target: tuple[float, float]) -> str:
        hands = _Hands(move, self._view)
        learned = self._known(hands)
        self._view.target = target
        start = hands.observe(1)
        ways = zip(learned.axes, learned.steps(target[0] - start.x, target[1] - start.y), strict=True)
        steps = " and ".join(f"{way:+.1f} steps of {axis}" for axis, way in ways).replace("-", "−")
        where = f"({target[0]:.0f}, {target[1]:.0f}) px"
        move.announce(f"the spot goes to {where}, about {steps}, in at most {CORRECTIONS} moves", self._announced_s)
        arrival = self._approach(hands, learned, target)
        if arrival.reached:
            return f"the spot is at {where}, within {WITHIN_PX:g} px, after {arrival.corrections} moves"
        return f"the spot is {arrival.off_px:.1f} px off {where} after {arrival.corrections} moves: click again"

    def _known(self, hands: "_Hands") -> Learned:
        learned = self._learned
        if learned is None or learned[0] != hands.board():
            self._learned = None
            raise BadValue("another board, camera or length of a step: press Learn again")
        return learned[1]

    def _approach(self, hands: "_Hands", learned: Learned, target: tuple[float, float]) -> Arrival:
        self._view.target = target
        return approach(hands, learned, target, hands.move.say)

    def _learn(self, move: PageMove) -> str:
        self._view.target = None
        x, y, *_ = self._worker.state.axes
        most = GAP_STEPS + LEARN_STEPS
        move.announce(f"Learn: {1 + LEARN_STEPS} to {most} steps of {x}, then of {y}", self._announced_s)
        hands = _Hands(move, self._view)
        board = hands.board()
        found = learn(hands, (x, y), move.say)
        self._learned = board, found
        (a, b), (c, d) = found.px
        lengths = f"{math.hypot(a, c):.1f} and {math.hypot(b, d):.1f} px"
        return f"a step of {x} and of {y} moves the spot by {lengths}: now click where it should go"


class _Hands:
    """The hands of pointing.py: the motions of a way, and the camera."""

    def __init__(self, move: PageMove, view: CameraView[LiveCamera]) -> None:
        self.move = move
        self._view = view
        self._observer = SpotObserver(view.live, view.live.found)
        self._step_us: dict[str, int] = {}

    def board(self) -> _Board:
        """What a response is of."""

        def ask(mount: Mount) -> _Board:
            axes = tuple(mount.by_name)[:2]
            steps = [mount.axis(axis).ask_whole("XP?", "XD?", "XI?") for axis in axes]
            self._step_us = {axis: step[0] for axis, step in zip(axes, steps, strict=True)}
            return mount.board_id, *axes, *map(tuple, steps)

        return *self.move.ask(ask), self._view.live.name, *self._view.live.size

    def step_us(self, axis: str) -> int:
        """The length of one step's pulse."""
        return self._step_us[axis]

    def step(self, axis: str, n: int) -> None:
        """Move by n steps. Raises NotInControl, MoveEnded, MountError."""
        self.move.make(Steps(axis, n), axis, n, longest_s=_MOTION_S)

    def pulse(self, axis: str, us: int) -> None:
        """Give one pulse. Raises as step()."""
        self.move.make(Pulse(axis, us), axis, longest_s=_MOTION_S)

    def observe(self, frames: int) -> Sighting:
        """Where the spot is. Raises NotInControl, SpotLost, CameraError."""
        self.move.check()
        sighting = self._observer.observe(frames)
        self.move.check()
        return sighting


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
