"""Raspberry Pi Pico or Pico 2 with a DRV8833, or another bridge with two PWM inputs a motor. Not tried on hardware.

The pins are those of pico.py without the enables, so that a mount can change its bridge and
keep its wires.
"""

from mountfw.boards import pico

NAME = pico.NAME
BRIDGE = "two-pwm"
AXIS_1 = {"en": None, "pos": 3, "neg": 4, "stop_pos": 10, "stop_neg": 11}
AXIS_2 = {"en": None, "pos": 6, "neg": 7, "stop_pos": 12, "stop_neg": 13}
EMERGENCY_STOP = pico.EMERGENCY_STOP
POWER = pico.POWER
PWM_HZ = pico.PWM_HZ
DEAD_TIME_US = 20  # both inputs low between two directions
LED = pico.LED
