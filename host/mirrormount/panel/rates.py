"""Rate limits: token buckets with a clock that is passed in. Pure."""

import time
from collections import OrderedDict
from collections.abc import Callable


class Rate:
    """At most `burst` events at once, and `per_s` a second over a long time."""

    def __init__(self, burst: float, per_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._burst = self._left = burst
        self._per_s = per_s
        self._clock = clock
        self._at_s = clock()

    def take(self) -> bool:
        """Count one event. False if it is above the rate."""
        now_s = self._clock()
        self._left = min(self._burst, self._left + (now_s - self._at_s) * self._per_s)
        self._at_s = now_s
        if self._left < 1:
            return False
        self._left -= 1
        return True


class Rates:
    """A Rate for each of the last `clients` clients."""

    def __init__(self, burst: float, per_s: float, clients: int = 256) -> None:
        self._new = lambda: Rate(burst, per_s)
        self._clients = clients
        self._rates: OrderedDict[str, Rate] = OrderedDict()

    def take(self, client: str) -> bool:
        """Count one event of this client. False if it is above its rate."""
        rate = self._rates.pop(client, None) or self._new()
        self._rates[client] = rate
        if len(self._rates) > self._clients:
            self._rates.popitem(last=False)
        return rate.take()
