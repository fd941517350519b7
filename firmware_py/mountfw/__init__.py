"""mountfw: the firmware of a motorised mirror mount, for MicroPython and CircuitPython boards.

Read app.py first: it is the loop; build.py composes it. docs/architecture.md tells who may import whom.
"""

__version__ = "0.2.0"
