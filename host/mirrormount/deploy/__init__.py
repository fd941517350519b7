"""Firmware onto a board and off it: the set of files, the Python prompt, MicroPython and CircuitPython."""
