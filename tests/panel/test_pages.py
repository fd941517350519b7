"""How many pages there may be, and which of them the panel knows."""

from mirrormount.panel.pages import CONNECTED, WAITING, WAITING_HERE, Pages
from mirrormount.supervise.lease import Lease


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


def test_a_page_of_another_run_is_not_known():
    pages = Pages(Lease())
    page = pages.add("here")
    assert pages.find(page.key) is page
    assert Pages(Lease()).find(page.key) is None
