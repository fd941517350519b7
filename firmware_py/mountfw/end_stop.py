"""The switches: an end-stop of an axis, and the emergency stop. Pure; imports nothing."""


class EndStop:
    """A normally closed switch to ground with a pull-up: high is active, and so is a broken wire.

    read returns 0 or 1, or is None where the board has no such input. A switch that is not fitted is never read.
    """

    def __init__(self, read):
        self._read = read
        self.has_input = read is not None
        self.fitted = False

    def active(self):
        """True while the switch says stop. Two readings must agree: motors are noisy neighbours."""
        return self.fitted and self._read() == 1 and self._read() == 1
