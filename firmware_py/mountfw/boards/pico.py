"""Raspberry Pi Pico with an SN754410, L293D or TB6612 (docs/bring-up.md has the wiring).

Not tried on hardware; in the emulator, with official images of MicroPython and CircuitPython.

To fit another board, copy this file under the name that the firmware asks for and change it. To
change the wiring of one mount, copy it to this.py on the board: that goes before every other. A file
with other names than these, or that uses a pin twice, is refused (board_file.py).
"""

NAME = b"Raspberry Pi Pico"

# "enable": one enable a motor, which carries the duty, and two legs.
# "two-pwm": two inputs a motor (DRV8833), `pos` and `neg`; `en` is then None.
BRIDGE = "enable"

# Axis 1 is motor 1, up and down; axis 2 is motor 2, right and left. `pos` is the leg that is
# high for a positive number. stop_pos and stop_neg are end-stop inputs, or None. GP0 and GP1
# are left for a UART. A third and a fourth motor are AXIS_3 and AXIS_4, with the same names.
# An axis may have an encoder as well: "encoder": (8, 9), A and B of a disc on the motor's shaft, or
# "shaft": (8, 9), SDA and SCL of an AS5600; 26 and 27 for axis 2 (docs/bring-up.md).
AXIS_1 = {"en": 2, "pos": 3, "neg": 4, "stop_pos": 10, "stop_neg": 11}
AXIS_2 = {"en": 5, "pos": 6, "neg": 7, "stop_pos": 12, "stop_neg": 13}

# An emergency stop: an input, 14 in docs/bring-up.md, with a normally closed button to ground. None: not fitted.
EMERGENCY_STOP = None

# An analog input, 26 to 29, at which a photodiode's amplifier tells the power of a fibre (docs/signal.md).
# None: not fitted. Nothing is driven by it, and 26 and 27 are an encoder's in docs/bring-up.md.
POWER = 28

# As made; the setting `pwm_hz` goes before it. Lower gives more torque at a low duty, higher a later
# whine; a new duty shows after at most one period. 4 kHz keeps that within 250 us and the period far
# above the bridge's switching times.
PWM_HZ = 4000

# Between the legs' change and the enable. The SN754410 switches within about 1 us.
DEAD_TIME_US = 10

# A pin, or the name that the platform gives it; None: no LED. One that this board lacks is left out.
LED = "LED"
