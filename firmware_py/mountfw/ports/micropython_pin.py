"""An output that can carry a duty, on a chip that has no gate (rp2_gate.py has its own). Imports nothing of ours."""

from machine import PWM, Pin

_OUT = Pin.OUT
_ALT = Pin.ALT
_ALT_PWM = Pin.ALT_PWM


class DutyPin:
    """A pin that can carry a duty.

    low() and high() go through the pin's function, at once. The PWM behind the pin keeps its old
    duty to the end of its period, and shows it only while the pin's function is PWM.
    """

    def __init__(self, number, pwm_hz):
        pin = Pin(number, Pin.OUT, value=0)
        self._function = pin.init
        self._duty_u16 = PWM(pin, freq=pwm_hz, duty_u16=0).duty_u16
        self.low()

    def low(self):
        """Pin low."""
        self._function(_OUT, value=0)

    def high(self):
        """Pin high."""
        self._function(_OUT, value=1)

    def level(self, duty_u16):
        """Pin at duty_u16, 0 ... 65535."""
        self._duty_u16(duty_u16)
        self._function(_ALT, alt=_ALT_PWM)
