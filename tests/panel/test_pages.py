"""How many pages there may be, and which of them the panel knows."""

import socket
from concurrent.futures import ThreadPoolExecutor

from mirrormount.supervise.lease import Lease
from mirrormount.supervise.worker import Worker
from mirrormount_panel.mounts import CONNECTED, WAITING, WAITING_HERE, Pages, PanelMount
from mirrormount_panel.server import Server


def test_pages_that_never_connect_are_dropped_the_oldest_first():
    lease, dropped = Lease(), []
    known = Pages(lease)
    pages = [known.add("10.0.0.1") for _ in range(WAITING_HERE)]
    for page in pages:
        page.drop = lambda page=page: dropped.append(page)
    connected = pages[0]
    lease.join(connected, object())
    for _ in range(3):
        known.add("10.0.0.1")
    assert dropped == pages[1:3] and known.find(connected.key) is connected
    for n in range(200):
        known.add(f"10.0.1.{n}")
    assert len(known) <= WAITING + 1


def test_the_number_of_open_pages_is_bounded():
    lease = Lease()
    pages = Pages(lease)
    for _ in range(CONNECTED):
        assert not pages.full
        lease.join(pages.add("10.0.0.1"), object())
    assert pages.full


def test_a_page_is_found_by_its_own_key_alone():
    pages, other_run = Pages(Lease()), Pages(Lease())
    known = [pages.add("here") for _ in range(3)]
    assert [pages.find(page.key) for page in known] == known
    for key in ("", "x", known[0].key[:-1], known[0].key + "x", "\ud800", other_run.add("here").key):
        assert pages.find(key) is None


def test_pages_that_are_closed_are_all_dropped():
    lease, dropped = Lease(), []
    pages = Pages(lease)
    for n in range(3):
        page = pages.add("here")
        page.drop = lambda page=page: (dropped.append(page), pages.forget(page))
        if n:
            lease.join(page, object())
    pages.close()
    assert len(dropped) == 3 and len(pages) == 0 and lease.clients == ()


def test_pages_are_dropped_before_the_web_server_ends_its_tasks():
    """The outbox of a page that lives on may go on for 2 s, and a line on stderr says so."""
    pages, left = Pages(Lease()), []

    async def app(_scope, receive, send) -> None:
        await receive()
        await send({"type": "lifespan.startup.complete"})
        assert (await receive())["type"] == "lifespan.shutdown"
        left.append(len(pages))
        await send({"type": "lifespan.shutdown.complete"})

    server = Server(app, [PanelMount("", Worker("virtual://", Lease()), pages)])
    server.when_ready(lambda: (pages.add("here"), setattr(server, "should_exit", True)))
    with socket.create_server(("127.0.0.1", 0)) as listener, ThreadPoolExecutor(1) as pool:
        pool.submit(server.run, [listener]).result()  # the browser of other tests has a loop in this thread
    assert left == [0]
