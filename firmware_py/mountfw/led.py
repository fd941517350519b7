"""What the LED shows. Pure; imports const."""

from mountfw import const

SLOT_MS = const(256)  # the loop sleeps to the end of one: asleep it obeys a stop soonest


def show(port, controller):
    """Update a port's LED: on = ready, blinking = driving, double blink = an error waits to be read."""
    slots = 0b00000101 if controller.errors.waiting else 0b11111111  # eight, the lowest bit first
    if controller.driving():
        slots = 0b01010101
    port.led(slots >> (port.ticks_ms() // SLOT_MS & 7) & 1)
