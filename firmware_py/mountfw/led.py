"""What the LED shows. Pure; imports const."""

from mountfw import const

SLOT_MS = const(512)  # the loop sleeps to the end of one: asleep it obeys a stop soonest


def show(port, controller):
    """Update a port's LED: on = ready, blinking = driving, a flash each 2 s = an error waits to be read."""
    slots = 0b00010001 if controller.errors.waiting else 0b11111111  # eight, the lowest bit first
    if controller.driving():
        slots = 0b01010101
    port.led(slots >> (port.ticks_ms() // SLOT_MS & 7) & 1)
