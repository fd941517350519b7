"""Any RP2040 or RP2350 board that has the Pico's pins, with an SN754410, L293D or TB6612. Not tried on hardware.

Only for `mirrormount deploy --board rp2`: check first that GPIO 2 to 7 and 10 to 13 of the board are free. No LED.
"""

from mountfw.boards.pico import *  # noqa: F403

NAME = b"RP2 board"
LED = None
