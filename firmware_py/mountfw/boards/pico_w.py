"""Raspberry Pi Pico W with an SN754410, L293D or TB6612: the Pico's pins. Not tried on hardware.

Its LED hangs on the radio chip, and to switch it there takes the loop's time: so it stays dark.
"""

from mountfw.boards.pico import *  # noqa: F403

NAME = b"Raspberry Pi Pico W"
LED = None
