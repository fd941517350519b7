"""The virtual board: the real firmware in a child process, and a bench that sees only its pins.

simulation.py owns the clock, the pins and the bytes. fakes/ is the hardware that the firmware imports. bench.py is
driven by the pins. clocks.py serves the board to hosts by the wall clock, or to one caller in this process as fast as
the processor allows. table.py puts boards, a laser and cameras on one clock. docs/virtual-board.md describes them.
"""

MACHINES = ("cpython", "micropython", "rp2040", "circuitpython")  # what may run the firmware: machines.py
