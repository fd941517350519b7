"""Direction buttons that go down and come up, in two threads."""

from collections import deque

from mirrormount.supervise.lease import Client
from mirrormount.supervise.requests import Press
from mirrormount.supervise.worker import Hold, Presses


def test_a_release_that_comes_while_its_press_leaves_the_queue_is_not_lost():
    presses = Presses()

    class Queue(deque):
        """Another thread releases the last press at the worst moment."""

        def popleft(self) -> Hold:
            hold = super().popleft()
            if presses.last:
                presses.last.released = True
            return hold

    presses._waiting = Queue()
    presses.add(Hold(Client("page"), Press({"x": 1}, 255), 0, 0.0))
    assert presses.pop().released
