"""Presize an object's table of attributes. Imports codes.

MicroPython keeps attributes in a hash table of 2, 4, 6, 8, 10, 12, 17, 23, 29, 37, 47, 59, 73 ... places (py/map.c),
and look-ups are slow where nearly all are taken: two attributes more made each frame take 5 % longer. A table never
shrinks, so the attributes that make it grow can be deleted again.
"""

from mountfw import codes

# names that nothing has as an attribute. New strings would stay in memory for ever, and take 60 us each
_NAMES = [name for name in codes.__dict__ if name[0] != "_"][:45]


def presize(*things):
    """Grow the attribute table of each thing until at most 3 of 5 places are taken."""
    for thing in things:
        taken = len(thing.__dict__)
        names = _NAMES[: taken * 5 // 3 - taken]
        for name in names:
            setattr(thing, name, None)
        for name in names:
            delattr(thing, name)
