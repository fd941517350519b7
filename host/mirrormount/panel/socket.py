"""The socket by which a page drives: orders, heartbeats and stops come in, ticks and the spot go out.

Not NiceGUI's own: that keeps what it could not send, and sends it when the network is back. A button that was
pressed meanwhile would then start a motor that nobody asks for any more. Here what cannot be sent is lost, and
what arrives late is seen to be late (desk.py). Only a stop is obeyed whenever it comes.
"""

import asyncio
import contextlib
import json
from typing import Any

from fastapi import APIRouter, Response, WebSocket, WebSocketDisconnect

from mirrormount.common.errors import BadValue
from mirrormount.common.tokens import same
from mirrormount.panel.auth import FLOOD
from mirrormount.supervise.lease import TICK_S, Desk, Page
from mirrormount.supervise.requests import parse
from mirrormount.supervise.worker import Pilot

_STOP = "STOP was pressed"
_LATE = "nothing was done: that came late, the network or this browser was stuck; ask again"
_WATCHES = "nothing was done: another page controls; take control first"
_LONGEST = 400  # characters of a message: more is no message of ours
_FIRST_S = 5.0  # until the first message, which says which page it is
_NO_KEY = 4401  # a close code: the page must sign in
_UNKNOWN_PAGE = 4404  # a close code: the page is of another run of the panel, and must be loaded again


def routes(desk: Desk, pilot: Pilot, key: str | None) -> APIRouter:
    """/drive, and /stop as a second way for the same word.

    key: what only a page of this panel's own origin has, beside its number (entrance.py); None: no sign-in is needed.
    """
    router = APIRouter()

    @router.websocket("/drive")
    async def drive(socket: WebSocket) -> None:
        await socket.accept()
        page, refused = await _introduced(socket, desk, key)
        if page is None:
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # it has gone
                await socket.close(refused)
            return
        tasks = [asyncio.create_task(_tick(socket, desk, pilot))]
        if isinstance(page.connection, WebSocket):  # what it holds through that one it cannot let go through this
            pilot.gone(page)
            tasks.append(asyncio.create_task(_see_off(page.connection)))
        desk.enter(page, socket)
        try:
            while True:
                text = await socket.receive_text()
                if page.connection is not socket:
                    break
                _hear(text, page, desk, pilot)
        except WebSocketDisconnect as e:
            if e.code == FLOOD:
                pilot.say(f"{page.name} was closed: it sent too many messages")
        except (RuntimeError, KeyError):  # KeyError: not a text
            pass
        finally:
            if desk.leave(page, socket):
                pilot.gone(page)
            for task in tasks:
                task.cancel()

    @router.post("/stop")
    async def stop() -> Response:
        pilot.stop(_STOP)
        return Response(status_code=204)

    return router


async def _introduced(socket: WebSocket, desk: Desk, key: str | None) -> tuple[Page | None, int]:
    """The page whose secrets are the first message, or None and the close code."""
    try:
        first = _parsed(await asyncio.wait_for(socket.receive_text(), _FIRST_S))
    except (TimeoutError, WebSocketDisconnect, RuntimeError, KeyError):
        return None, _NO_KEY
    if key is not None and not same(str(first.get("key")).encode("utf-8", "replace"), key.encode()):
        return None, _NO_KEY
    return desk.find(str(first.get("page"))), _UNKNOWN_PAGE


async def _see_off(socket: WebSocket) -> None:
    """Close the connection of a page that has come again: if it is a copy of that page, it must be loaded anew."""
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(_UNKNOWN_PAGE)


def _hear(text: str, page: Page, desk: Desk, pilot: Pilot) -> None:
    """Obey one message."""
    message = _parsed(text)
    what = message.get("do")
    if what == "stop":
        pilot.stop(_STOP)
        return
    fresh = desk.hear(page, message.get("tick"))
    if what == "release":
        pilot.release(page)
    elif what == "beat":
        pass
    elif not fresh:
        page.notices.append(_LATE)
    elif what == "claim":
        if desk.controller is not page:
            pilot.stop(f"{page.name} took control")
            desk.claim(page)
    elif desk.controller is not page:
        page.notices.append(_WATCHES)
    else:
        try:
            pilot.order(page, parse(message))
        except BadValue as e:
            page.notices.append(f"nothing was done: {e}")


def refusal(desk: Desk, page: Page, tick: object) -> str:
    """Why what this page asks for, having seen that tick, is not done; "" if it may be."""
    if not desk.hear(page, tick):
        return _LATE
    if desk.controller is not page:
        return _WATCHES
    return ""


def _parsed(text: str) -> dict[str, Any]:
    with contextlib.suppress(ValueError, RecursionError):
        message = json.loads(text) if len(text) <= _LONGEST else None
        if isinstance(message, dict):
            return message
    return {}


async def _tick(socket: WebSocket, desk: Desk, pilot: Pilot) -> None:
    """Send the time, and where the virtual board's spot is, until the page has gone."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            message: dict[str, Any] = {"tick": desk.tick()}
            spot = pilot.spot_mm()
            if spot:
                message["spot"] = [round(mm, 3) for mm in spot]
            await socket.send_text(json.dumps(message))
            await asyncio.sleep(TICK_S)
