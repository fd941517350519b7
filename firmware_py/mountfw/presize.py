"""Presize an object's table of attributes. Pure; imports nothing of ours.

MicroPython keeps attributes in a hash table of 2, 4, 6, 8, 10, 12, 17, 23, 29, 37, 47, 59, 73 ... places (py/map.c),
and look-ups are slow where nearly all are taken: two attributes more made each frame take 5 % longer. A table never
shrinks, so the attributes that make it grow can be deleted again.
"""


class _Room:
    pass


_room = _Room()
for _i in range(30):
    setattr(_room, "_room%d" % _i, None)
_NAMES = list(_room.__dict__)  # as attributes have them: new strings would have to be looked up, 60 us each


def presize(thing, most):
    """Grow the attribute table of thing until `most` attributes fit; most is a little more than it has."""
    names = _NAMES[: max(0, most - len(thing.__dict__))]
    for name in names:
        setattr(thing, name, None)
    for name in names:
        delattr(thing, name)
