"""What the LED shows. Pure; imports nothing."""


def show(port, controller):
    """Update a port's LED: on = ready, blinking = driving, double blink = an error waits to be read."""
    slots = 0b00000101 if controller.errors.waiting else 0b11111111  # eight of 128 ms, the lowest bit first
    if controller.driving():
        slots = 0b01010101
    port.led(slots >> (port.ticks_ms() >> 7 & 7) & 1)
