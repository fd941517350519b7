"""The socket by which a page drives: requests, heartbeats and stops in, ticks and the spot out.

Not NiceGUI's own: that keeps messages it could not send, and sends them when the network is back. A button that was
pressed meanwhile would then start a motor much later. Here a message that cannot be sent is lost, and one that
arrives late is known to be late by its tick (lease.py). Only a stop is carried out however late it arrives.
"""

import asyncio
import contextlib
import json
from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter, Response, WebSocket, WebSocketDisconnect

from mirrormount.errors import BadValue, NotInControl
from mirrormount.supervise.lease import TICK_S
from mirrormount.supervise.requests import parse
from mirrormount.supervise.worker import Worker
from mirrormount_panel.auth import FLOOD, same
from mirrormount_panel.mounts import Orders, Page, PanelMount, Part, find, stop_all

_STOP = "STOP was pressed"
_LATE = "nothing was done: that came late, the network or this browser was stuck; ask again"
_LONGEST = 400  # No message of a page has more characters.
_FIRST_S = 5.0  # The first message, which names the page, must come within this time.
_NO_KEY = 4401  # The close code for a page that must sign in.
_UNKNOWN_PAGE = 4404  # The close code for a page of an earlier run of the panel, which loads itself again.


def routes(mounts: Sequence[PanelMount], key: str | None) -> APIRouter:
    """The routes /drive, and /stop as a second way for a stop. A socket is of the mount whose page's key it shows.

    key: a secret in the storage of this panel's origin (auth.py), None if no sign-in is needed.
    """
    router = APIRouter()

    @router.websocket("/drive")
    async def drive(socket: WebSocket) -> None:
        await socket.accept()
        part, refused = await _introduced(socket, mounts, key)
        if part is None:
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # it has gone
                await socket.close(refused)
            return
        mount, page = part
        worker = mount.worker
        tasks = [asyncio.create_task(_tick(socket, worker))]
        if isinstance(page.connection, WebSocket):  # a button held through that one cannot be released through this
            worker.client_left(page)
            tasks.append(asyncio.create_task(_see_off(page.connection)))
        worker.lease.join(page, socket)
        try:
            while True:
                text = await socket.receive_text()
                if page.connection is not socket:
                    break
                message = _parsed(text)
                if message.get("do") == "stop":
                    stop_all(mounts, _STOP)
                    worker.lease.take_over(page, _STOP)
                else:
                    _receive(message, page, worker, mount.orders)
        except WebSocketDisconnect as e:
            if e.code == FLOOD:
                worker.report(f"{page.name} was cut off: it sent too many messages; it connects again by itself")
        except (RuntimeError, KeyError):  # KeyError: not a text
            pass
        finally:
            if worker.lease.leave(page, socket):
                worker.client_left(page)
            for task in tasks:
                task.cancel()

    @router.post("/stop")
    async def stop() -> Response:
        stop_all(mounts, _STOP)
        return Response(status_code=204)

    return router


async def _introduced(socket: WebSocket, mounts: Sequence[PanelMount], key: str | None) -> tuple[Part | None, int]:
    """The page whose secrets the first message has, or None and the close code."""
    try:
        first = _parsed(await asyncio.wait_for(socket.receive_text(), _FIRST_S))
    except (TimeoutError, WebSocketDisconnect, RuntimeError, KeyError):
        return None, _NO_KEY
    if key is not None and not same(str(first.get("key")).encode("utf-8", "replace"), key.encode()):
        return None, _NO_KEY
    return find(mounts, str(first.get("page"))), _UNKNOWN_PAGE


async def _see_off(socket: WebSocket) -> None:
    """Close the older connection of a page that has connected again; a copy of that page must be reloaded."""
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(_UNKNOWN_PAGE)


def _receive(message: dict[str, Any], page: Page, worker: Worker, orders: Orders) -> None:
    """Carry out one message."""
    what = message.get("do")
    fresh = worker.lease.receive(page, message.get("tick"))
    if what == "release":
        worker.release(page)
    elif what == "beat":
        pass
    elif not fresh:
        page.notices.append(_LATE)
    else:
        try:
            _carry_out(message, page, worker, orders)
        except BadValue as e:
            page.notices.append(f"nothing was done: {e}")
        except NotInControl as e:
            page.notices.append(str(e))


def _carry_out(message: dict[str, Any], page: Page, worker: Worker, orders: Orders) -> None:
    """Carry out a fresh message. Raises BadValue, NotInControl."""
    holder = worker.lease.holder
    match message.get("do"):
        case "claim":
            worker.take_control(page)
        case "hand over":
            worker.hand_over(page, message.get("question"))
        case "keep":
            worker.lease.keep(page, message.get("question"))
        case _ if holder is None or (holder is not page and holder.is_person):
            raise NotInControl(_watches(worker))
        case what:
            order = orders.by_name.get(what) if isinstance(what, str) else None
            request = None if order else parse(message, worker.state.axes)
            if holder is not page:  # a press takes control from a program
                worker.take_control(page)
            if order:
                order(page, message)
            elif request:
                orders.give_way()
                worker.request(page, request)


def refusal(worker: Worker, page: Page, tick: object) -> str:
    """Why a request of this page, made when it had seen that tick, is refused; "" if it is not."""
    if not worker.lease.receive(page, tick):
        return _LATE
    return "" if worker.lease.holder is page else _watches(worker)


def _watches(worker: Worker) -> str:
    holder = worker.lease.holder
    if holder is None:
        return "nothing was done: no page controls; take control first"
    return f"nothing was done: {'another page' if holder.is_person else holder.name} controls; take control first"


def _parsed(text: str) -> dict[str, Any]:
    with contextlib.suppress(ValueError, RecursionError):
        message = json.loads(text) if len(text) <= _LONGEST else None
        if isinstance(message, dict):
            return message
    return {}


async def _tick(socket: WebSocket, worker: Worker) -> None:
    """Send ticks, and the position of a virtual board's spot, until the page disconnects."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            message: dict[str, Any] = {"tick": worker.lease.tick()}
            spot = worker.connection.spot_mm()
            if spot:
                message["spot"] = [round(mm, 3) for mm in spot]
            await socket.send_text(json.dumps(message))
            await asyncio.sleep(TICK_S)
