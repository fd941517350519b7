"""What a start does for the memory: quick tables of attributes; and what it alone needs goes. Imports nothing of ours.

MicroPython keeps attributes in a hash table of 2, 4, 6, 8, 10, 12, 17, 23, 29, 37, 47, 59, 73 ... places (py/map.c),
and look-ups are slow where nearly all are taken: two attributes more made each frame take 5 % longer. A table never
shrinks, so the attributes that make it grow can be deleted again.
"""

import sys

_ONLY_AT_START = {
    "mountfw": ("build", "memory", "board_file", "parts"),
    "mountfw.ports": ("rp2_listed", "rp2_handlers"),
}


def presize(things, axes):
    """Grow the attribute table of each thing, and of each part of an axis, until at most 2 of 3 places are taken.

    By names that others of them have: new strings would stay in memory for ever, and take 60 us each.
    """
    names = {name for thing in things for name in thing.__dict__}
    for axis in axes:
        things += [axis, axis.drive, axis.position, axis.drive.bridge]
    for thing in things:
        taken = thing.__dict__
        left = len(taken) // 2
        added = []
        for name in names:
            if not left:
                break
            if name not in taken:
                setattr(thing, name, None)
                added.append(name)
                left -= 1
        for name in added:
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
