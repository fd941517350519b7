"""Raspberry Pi Pico 2 with an SN754410, L293D or TB6612: the Pico's pins. Not tried on hardware.

Its pull-downs outside have to be stronger than a Pico's: docs/bring-up.md, section 1.
"""

from mountfw.boards.pico import *  # noqa: F403

NAME = b"Raspberry Pi Pico 2"
