"""An axis with an encoder where the board file names one, else one without. Imports axis, and encoder only then."""

from mountfw.motion.axis import Axis


def make(port, pins, number, bridge, positive_stop, negative_stop, error_queue, ticks_us):
    """The Axis of these parts, its arguments; one with an encoder where its pins name one that the port can read."""
    reader = port.encoder(number, pins) if "encoder" in pins or "shaft" in pins else None
    if reader is None:
        return Axis(number, bridge, positive_stop, negative_stop, error_queue, ticks_us)
    from mountfw.encoder.axis import EncodedAxis

    return EncodedAxis(number, bridge, positive_stop, negative_stop, error_queue, ticks_us, reader)
