"""The panel's routes served in this process, and driving sockets of pages, without a browser."""

import asyncio
import contextlib
import json
import socket
import threading
from collections.abc import Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor

import uvicorn
from websockets.sync.client import ClientConnection, connect

from mirrormount.supervise.worker import Worker


def run(work: Coroutine[object, object, object]) -> object:
    """Await it in a thread of its own: where a browser is under test, this thread has a loop already."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, work).result()


def ticked(at: str) -> ClientConnection:
    """A driving socket, whose ticks nobody reads."""
    return connect(f"ws://{at}/drive", max_queue=None)


@contextlib.contextmanager
def served(app) -> Iterator[str]:
    """A web server in a thread; yields its address."""
    listener = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(app, log_config=None, timeout_graceful_shutdown=1))
    thread = threading.Thread(target=server.run, args=([listener],))
    thread.start()
    try:
        yield f"127.0.0.1:{listener.getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join()
        listener.close()


def order(worker: Worker, end: ClientConnection, **message) -> None:
    """Send an order of a page, with a fresh tick unless it has one."""
    end.send(json.dumps({"tick": worker.lease.tick(), **message}))
