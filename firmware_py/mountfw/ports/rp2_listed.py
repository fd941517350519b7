"""The folder mountfw for imports, listed once. Imports nothing of ours; main.py takes it first.

MicroPython looks for a file to import at four places, and littlefs takes a Pico 4 ms for each. While this is mounted
over the folder, three of these are answers out of a table: a start takes 0.2 s less. It looks for files even in place
of its own modules, each time that one is imported: 3 ms, unless the module is in sys.modules.
"""

import os
import sys

_OWN = ("array", "binascii", "hashlib", "machine", "os", "select", "sys", "time")
_PLACE = "/mountfw"
_UNDER = "./mountfw"  # the same folder of the flash, past the mount
_FOLDER = 0x4000
_LATER = "encoder"  # a folder that is imported when this has left, if at all
_STATS = {kind: (kind, 0, 0, 0, 0, 0, 0, 0, 0, 0) for kind in (_FOLDER, 0x8000)}  # made once: the heap is nearly full
_DOCSTRING = 128  # a folder's __init__ of fewer bytes has nothing else: the folder alone will do


class _Listed:
    """A file system as MicroPython's mount() takes it: what imports and listdir() need, no more."""

    def __init__(self):
        self._stats = {"/": _STATS[_FOLDER]}
        self.stat = self._stats.__getitem__  # three calls an import, 0.4 ms each if written here; any error will do
        self._list("/")

    def _list(self, folder):
        for name, kind, _, size in os.ilistdir(_UNDER + folder):  # pyright: ignore[reportAttributeAccessIssue]
            if name.startswith("__init__.") and size < _DOCSTRING and folder != "/":
                continue
            self._stats[folder + name] = _STATS[kind]
            if kind == _FOLDER and name != _LATER:
                self._list(folder + name + "/")

    def mount(self, _readonly, _mkfs):
        pass

    def umount(self):
        pass

    def ilistdir(self, path):
        start = path if path == "/" else path + "/"
        inside = [p for p in self._stats if p.startswith(start) and "/" not in p[len(start) :]]
        return iter([(p[len(start) :], self._stats[p][0], 0) for p in inside])

    def open(self, path, mode):
        return open(_UNDER + path, mode)


def enter():
    """Answer for the folder, on an RP2040 or RP2350. Other platforms import as they do."""
    if sys.platform == "rp2":
        path = sys.path[:]
        try:
            sys.path.clear()
            for name in _OWN:
                sys.modules[name] = __import__(name)
        finally:
            sys.path[:] = path
        try:
            os.mount(_Listed(), _PLACE)  # pyright: ignore[reportAttributeAccessIssue]
        except OSError:  # the program was not started where the folder is
            pass


def leave():
    """The folder is the flash's again. May be called twice."""
    if sys.platform == "rp2":
        try:
            os.umount(_PLACE)  # pyright: ignore[reportAttributeAccessIssue]
        except OSError:
            pass
