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

    def retract(self, code):
        """Remove the newest error if it is this one: a more exact one follows."""
        if self.waiting and self._codes[self.waiting - 1] == code:
            self.waiting -= 1
            self._codes[self.waiting] = 0

    def pop(self):
        """Remove and return the oldest error's code; 0 if none waits."""
        code = self._codes[0]
        if code:
            self.waiting -= 1
            for i in range(_ROOM):
                self._codes[i] = self._codes[i + 1] if i < self.waiting else 0
        return code
