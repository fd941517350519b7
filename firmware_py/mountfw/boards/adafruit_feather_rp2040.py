"""Adafruit Feather RP2040 with an SN754410, L293D or TB6612. Not tried on hardware.

Numbers are GPIOs; in brackets, what is printed on the board. See pico.py for what the names mean.
"""

NAME = b"Adafruit Feather RP2040"
BRIDGE = "enable"

AXIS_1 = {"en": 7, "pos": 8, "neg": 9, "stop_pos": 26, "stop_neg": 27}  # (5 6 9, A0 A1)
AXIS_2 = {"en": 10, "pos": 11, "neg": 12, "stop_pos": 28, "stop_neg": 29}  # (10 11 12, A2 A3)
EMERGENCY_STOP = None  # 24 (24), if one is fitted

PWM_HZ = 4000
DEAD_TIME_US = 10
LED = 13
