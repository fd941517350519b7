"""Raspberry Pi Pico 2 W with an SN754410, L293D or TB6612: the Pico's pins. Not tried on hardware.

See pico2.py for the pull-downs and pico_w.py for the LED.
"""

from mountfw.boards.pico_w import *  # noqa: F403

NAME = b"Raspberry Pi Pico 2 W"
