"""Reads a board's port in a thread and writes to a socket: select() cannot wait for a Port."""

import socket
import threading

from mirrormount.common.errors import ConnectionLost
from mirrormount.transport.port import Port

_WAIT_S = 0.05  # the longest read, after which close() is noticed


class PortReader:
    """The board's bytes come out of `end`. After the board is lost, `end` is at its end and `lost` has the cause."""

    def __init__(self, port: Port) -> None:
        self.end, self._output = socket.socketpair()
        self.lost = "the board has gone"
        self._port = port
        self._tail = b""
        self._closing = False
        self._thread = threading.Thread(target=self._read, name="port reader", daemon=True)
        self._thread.start()

    def at_prompt(self, data: bytes) -> bool:
        """True if Python's prompt is in the board's bytes; it is in no reply of the firmware."""
        received = self._tail + data
        self._tail = received[-3:]
        return b">>> " in received

    def close(self) -> None:
        """Stop reading; bytes that were read and not taken are lost."""
        self._closing = True
        self.end.close()
        self._thread.join()

    def _read(self) -> None:
        try:
            while not self._closing:
                self._output.sendall(self._port.read(_WAIT_S))
        except ConnectionLost as e:
            self.lost = str(e)
        except OSError:  # closed
            pass
        finally:
            self._output.close()
