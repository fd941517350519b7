"""Shared by the fakes of CircuitPython's modules: owners of pins, and the limits of a build."""

import _seam

claimed = {}  # GPIO number: its owner
in_boot_py = True  # USB and the drive can be arranged then only


def claim(pin, owner):
    if not isinstance(pin, Pin):
        raise TypeError("pin must be of type Pin, not %s" % type(pin).__name__)
    if pin.number in claimed:
        raise ValueError("GPIO%d in use" % pin.number)
    claimed[pin.number] = owner


def release(pin):
    """The pin has no owner and does not drive: the external resistor pulls it low."""
    del claimed[pin.number]
    _seam.seam.unlatch(pin.number)
    _seam.seam.edge(pin.number, 0)


def deinited():
    return ValueError("Object has been deinitialized and can no longer be used. Create a new object.")


class Pin:
    """One GPIO."""

    def __init__(self, number):
        self.number = number


gpio = {number: Pin(number) for number in range(49)}


def reset():
    """Release the pins, as CircuitPython does at the end of a program."""
    for number in list(claimed):
        if number in claimed:  # its owner may have had another one, too
            claimed[number].deinit()
