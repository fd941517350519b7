"""What a board's process writes on its stderr: not shown, but for its last line when the process has ended."""

import os
import threading
from typing import IO

_KEPT = 4096  # bytes: a firmware may make an emulator complain for a week
_PATIENCE_S = 1.0  # until the rest has come of a process that has ended


class LastWords:
    """Reads the stream, so that its writer never waits."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self._tail = stream, b""
        self._thread = threading.Thread(target=self._read, name="last words", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with self._stream as stream:
            while data := os.read(stream.fileno(), _KEPT):
                self._tail = (self._tail + data)[-_KEPT:]

    def line(self) -> str:
        """The last line that is not empty, "" if there is none."""
        self._thread.join(_PATIENCE_S)
        lines = self._tail.decode(errors="replace").split("\n")
        return next((line.strip()[:200] for line in reversed(lines) if line.strip()), "")
