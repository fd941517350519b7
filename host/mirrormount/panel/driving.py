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

from mirrormount.errors import BadValue
from mirrormount.panel.desk import TICK_S, Desk, Page
from mirrormount.panel.orders import parse
from mirrormount.panel.pilot import Pilot

_LATE = "nothing was done: that came late, the network or this browser was stuck; ask again"
_WATCHES = "nothing was done: another page controls; take control first"
_LONGEST = 400  # characters of a message: more is no message of ours
_UNKNOWN_PAGE = 4404  # a close code: the page is of another run of the panel, and must be loaded again


def routes(desk: Desk, pilot: Pilot) -> APIRouter:
    """/drive, and /stop as a second way for the same word."""
    router = APIRouter()

    @router.websocket("/drive/{key}")
    async def drive(socket: WebSocket, key: str) -> None:
        await socket.accept()
        page = desk.find(key)
        if page is None:
            await socket.close(_UNKNOWN_PAGE)
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
        except (WebSocketDisconnect, RuntimeError, KeyError):  # KeyError: not a text
            pass
        finally:
            if desk.leave(page, socket):
                pilot.gone(page)
            for task in tasks:
                task.cancel()

    @router.post("/stop")
    async def stop() -> Response:
        pilot.stop()
        return Response(status_code=204)

    return router


async def _see_off(socket: WebSocket) -> None:
    """Close the connection of a page that has come again: if it is a copy of that page, it must be loaded anew."""
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(_UNKNOWN_PAGE)


def _hear(text: str, page: Page, desk: Desk, pilot: Pilot) -> None:
    """Obey one message."""
    message = _parsed(text)
    what = message.get("do")
    if what == "stop":
        pilot.stop()
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
            pilot.stop()
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
