"""Seeed Studio XIAO RP2040 with an SN754410, L293D or TB6612. Not tried on hardware.

Numbers are GPIOs; in brackets, what is printed on the board. See pico.py for what the names mean.
"""

NAME = b"Seeed XIAO RP2040"
BRIDGE = "enable"

AXIS_1 = {"en": 26, "pos": 27, "neg": 28, "stop_pos": 1, "stop_neg": 2}  # (D0 D1 D2, D7 D8)
AXIS_2 = {"en": 29, "pos": 6, "neg": 7, "stop_pos": 4, "stop_neg": 3}  # (D3 D4 D5, D9 D10)
EMERGENCY_STOP = None  # 0 (D6), if one is fitted

PWM_HZ = 4000
DEAD_TIME_US = 10
LED = None  # its LEDs are lit while their pins are low: the opposite of what the firmware shows
