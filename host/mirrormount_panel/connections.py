"""Connections of a web server: how many at once, and how long one may take over a request.

Without a bound, whoever opens connections and sends half a request takes all files of the process, and then no page, no
stop and no `mirrormount stop` gets in.
"""

import asyncio

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

_REQUEST_S = 10.0  # from a connection, or from the last request on it, until the next request is whole
_MOST = 200  # connections at once that are no sockets; a process has 1024 files on Linux, 256 on macOS


class BoundedConnection(HttpToolsProtocol):
    """A connection as uvicorn's; it is closed when no request has become whole in time.

    One more than _MOST closes the oldest, so that there is always room for a stop.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """As uvicorn's."""
        super().connection_made(transport)
        self._served = None
        self._deadline = self.loop.call_later(_REQUEST_S, self._end_if_idle)
        others = [one for one in self.connections if isinstance(one, BoundedConnection)]
        if len(others) > _MOST:
            min(others, key=lambda one: one._deadline.when()).transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """As uvicorn's."""
        self._deadline.cancel()
        super().connection_lost(exc)

    def handle_websocket_upgrade(self) -> None:
        """As uvicorn's: from here on the socket's own bounds hold."""
        self._deadline.cancel()
        super().handle_websocket_upgrade()

    def _end_if_idle(self) -> None:
        cycle = self.cycle
        is_new, self._served = cycle is not self._served, cycle
        is_idle = cycle is not None and cycle.response_complete and not is_new
        if cycle is None or cycle.more_body or is_idle:
            self.transport.abort()
        else:
            self._deadline = self.loop.call_later(_REQUEST_S, self._end_if_idle)
