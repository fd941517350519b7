"""Room in an object's table of attributes. Pure; imports nothing of ours.

MicroPython keeps an object's attributes in a hash table of 2, 4, 6, 8, 10, 12, 17, 23, 29, 37, 47, 59, 73 ... places
(py/map.c), and finds one slowly where nearly all are taken: each frame took 5 % longer when two attributes more had
filled two tables. A table never shrinks, so what makes it grow may go again.
"""


def make_room(thing, most):
    """Have the table of thing grow to where `most` attributes fit; most is a little more than it has."""
    names = ["_room%d" % i for i in range(most - len(thing.__dict__))]
    for name in names:
        setattr(thing, name, None)
    for name in names:
        delattr(thing, name)
