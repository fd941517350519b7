"""The virtual board: the real firmware in a child process, and a bench that sees only its pins.

world.py owns the clock, the pins and the bytes; fakes/ is the hardware that the firmware
imports; bench.py is what the pins drive; live.py shows the board to hosts in real time and
stepped.py to one in this process, as fast as it goes. docs/architecture.md tells the whole.
"""
