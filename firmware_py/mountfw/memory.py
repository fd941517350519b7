"""What a start does for the memory: quick tables of attributes; and what it alone needs goes. Imports actions, axis.

MicroPython keeps attributes in a hash table of 2, 4, 6, 8, 10, 12, 17, 23, 29, 37, 47, 59, 73 ... places (py/map.c),
and look-ups are slow where nearly all are taken: two attributes more made each frame take 5 % longer. A table never
shrinks, so the attributes that make it grow can be deleted again.
"""

import sys

from mountfw.motion.actions import Actions
from mountfw.motion.axis import Axis

_ONLY_AT_START = {
    "mountfw": ("build", "memory", "board_file"),
    "mountfw.ports": ("rp2_listed", "rp2_handlers"),
}
# names that are there: new strings would stay in memory for ever, and take 60 us each
_NAMES = [name for name in list(Axis.__dict__) + list(Actions.__dict__) if name[0] != "_"]


def presize(*things):
    """Grow the attribute table of each thing until at most 3 of 5 places are taken."""
    for thing in things:
        taken = len(thing.__dict__)
        names = [name for name in _NAMES if name not in thing.__dict__][: taken * 5 // 3 - taken]
        for name in names:
            setattr(thing, name, None)
        for name in names:
            delattr(thing, name)


def forget_start():
    """Give the memory back of modules that only a start needs: 12 KB. Who imports one again has a new one."""
    for package, names in _ONLY_AT_START.items():
        for name in names:
            for module in (package + "." + name, name):  # main.py finds one without its package
                if module in sys.modules:
                    _drop(sys.modules, module)
            if hasattr(sys.modules[package], name):
                _drop(sys.modules[package].__dict__, name)


def _drop(table, key):
    table[key] = None  # MicroPython keeps the value of a key that is only deleted
    del table[key]
