"""The virtual board: the real firmware in a child process, and a bench that sees only its pins.

simulation.py owns the clock, the pins and the bytes. fakes/ is the hardware that the firmware imports. bench.py is
driven by the pins. realtime.py serves the board to hosts by the wall clock, lockstep.py serves it to one caller in this
process as fast as the processor allows. docs/virtual-board.md describes the machines. virtual_table.py puts boards, a
laser and cameras on one clock: docs/table.md.
"""
