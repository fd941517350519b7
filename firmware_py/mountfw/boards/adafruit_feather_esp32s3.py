"""Adafruit Feather ESP32-S3 with an SN754410, L293D or TB6612. Not tried on hardware.

Numbers are GPIOs; in brackets, what is printed on the board. The same places as on the Feather RP2040. See pico.py for
what the names mean.
"""

NAME = b"Adafruit Feather ESP32-S3"
BRIDGE = "enable"

AXIS_1 = {"en": 5, "pos": 6, "neg": 9, "stop_pos": 18, "stop_neg": 17}  # (5 6 9, A0 A1)
AXIS_2 = {"en": 10, "pos": 11, "neg": 12, "stop_pos": 16, "stop_neg": 15}  # (10 11 12, A2 A3)
EMERGENCY_STOP = None  # 14 (A4), if one is fitted

PWM_HZ = 4000
DEAD_TIME_US = 10
LED = 13

# USB has 5 inward endpoints here: its own, two for a serial channel, one for the drive. A second serial channel
# would need two more, and CircuitPython would start in safe mode. So the protocol runs on the console.
ONE_CHANNEL = True
