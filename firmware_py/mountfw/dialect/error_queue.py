"""The queue of errors that wait to be read. Pure; imports codes."""

from mountfw import const
from mountfw.codes import ANSWER_DROPPED

_ROOM = const(10)


class ErrorQueue:
    """The ten oldest unread errors. A newer one is dropped while these wait."""

    def __init__(self):
        self._codes = [0] * _ROOM  # the oldest first; 0 beyond those that wait
        self.waiting = 0

    def clear(self):
        """Empty the queue."""
        while self.pop():
            pass

    def push(self, code):
        """Queue error code, unless ten older ones wait. One ANSWER_DROPPED is enough."""
        if self.waiting < _ROOM and (code != ANSWER_DROPPED or code not in self._codes):
            self._codes[self.waiting] = code
            self.waiting += 1

    def pop(self):
        """Remove and return the oldest error's code; 0 if none waits."""
        code = self._codes[0]
        if code:
            self.waiting -= 1
            for i in range(_ROOM):
                self._codes[i] = self._codes[i + 1] if i < self.waiting else 0
        return code
