"""Listens to a board in a thread, for a program that waits for sockets: a Port cannot be waited for with them."""

import socket
import threading

from mirrormount.common.errors import ConnectionLost
from mirrormount.transport.port import Port

_WAIT_S = 0.05  # how often it looks whether to go on


class Ear:
    """What the board says comes out of `end`; when the board has gone, `end` ends and `lost` says why."""

    def __init__(self, port: Port) -> None:
        self.end, self._mouth = socket.socketpair()
        self.lost = "the board has gone"
        self._port = port
        self._tail = b""
        self._closing = False
        self._thread = threading.Thread(target=self._listen, name="ear", daemon=True)
        self._thread.start()

    def at_prompt(self, data: bytes) -> bool:
        """True if Python's prompt is in what the board says; it is in no answer of the firmware."""
        heard = self._tail + data
        self._tail = heard[-3:]
        return b">>> " in heard

    def close(self) -> None:
        """Stop listening; what was heard and not taken is forgotten."""
        self._closing = True
        self.end.close()
        self._thread.join()

    def _listen(self) -> None:
        try:
            while not self._closing:
                self._mouth.sendall(self._port.read(_WAIT_S))
        except ConnectionLost as e:
            self.lost = str(e)
        except OSError:  # closed
            pass
        finally:
            self._mouth.close()
