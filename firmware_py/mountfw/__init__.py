"""mountfw: the firmware of a motorised mirror mount, for MicroPython and CircuitPython boards.

Read app.py first: it is the loop; build.py composes it. docs/architecture.md tells who may import whom.
"""

__version__ = "0.3.0"


def const(value):
    """The value. MicroPython's compiler takes `const(5)` in the place of the name: no look-up, and no memory."""
    return value
