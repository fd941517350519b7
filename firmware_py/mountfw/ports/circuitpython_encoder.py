"""Readers of encoders on CircuitPython: rotaryio, and an AS5600. encoders.py says what a reader is."""

from mountfw.ports.encoders import Turns

_ADDRESS = 0x36  # AS5600 data sheet: its only one
_STATUS = b"\x0b"  # the register before RAW ANGLE
_readers = {}  # pins: reader; its pins are taken until it is given back


def reader(number, pins, pin_of):
    """The reader of axis `number`'s encoder. None, after a printed line, where this board has no way to count.

    pin_of(number) is the port's pin.
    """
    pair = pins.get("shaft") or pins["encoder"]
    if pair not in _readers:
        try:
            two = [pin_of(pin) for pin in pair]
            _readers[pair] = Shaft(*two) if "shaft" in pins else Edges(*two)
        except (ImportError, OSError, RuntimeError) as e:  # the last two: an ESP32 without a free counter
            print("mountfw: axis %d: encoder not fitted: %s" % (number, e))
            return None
    return _readers[pair]


class Edges:
    """Edges of A and B, counted by rotaryio."""

    gone = False
    slips = 0
    play_us = 0

    def __init__(self, a, b):
        import rotaryio

        self._encoder = rotaryio.IncrementalEncoder(a, b, 1)

    def counts(self):
        """The edges so far; A before B is positive."""
        return self._encoder.position


class Shaft(Turns):
    """An AS5600 on a bus of its own."""

    def __init__(self, sda, scl):
        import busio

        super().__init__()
        self._answer = bytearray(3)
        self._is_asked = False
        try:
            self._bus = busio.I2C(scl, sda, frequency=400_000)
            self._is_asked = self._bus.try_lock()
        except RuntimeError as e:  # no pull-ups: nothing is plugged in
            print("mountfw: encoder at pins %s and %s: %s" % (sda, scl, e))

    def counts(self):
        """4096 a turn; the lowest 12 bits are the angle."""
        if not self._is_asked:
            return self.count
        answer = self._answer
        try:
            self._bus.writeto_then_readfrom(_ADDRESS, _STATUS, answer)
        except OSError:
            # one that is gone: not until the next start, for CircuitPython waits a second for a bus that hangs
            self._is_asked = not self.silent()
        else:
            self.take(answer[0], answer[1], answer[2])
        return self.count
