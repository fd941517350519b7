"""The settings of one axis as its attributes, and its end-stops. Imports position, settings.

settings.py declares them: name, range, default. A change counts from the next move on: the amounts of
drive of a step and of the gap are computed while no move is under way.
"""

from mountfw.motion.position import Position
from mountfw.settings import SETTINGS, Settings

_REST_US = 1_000  # least rest after a pulse


class AxisSettings(Settings):
    """The settings of one axis. The two EndStops are named for the electrical direction."""

    def __init__(self, positive_stop, negative_stop):
        self.positive_stop = positive_stop
        self.negative_stop = negative_stop
        self.watched = False  # True if an end-stop can end a move
        self.changed = False  # in the middle of a move
        self.state = 0
        self.position = Position()

    def moving(self):
        """True from a move's acceptance to its last pulse's end."""
        return self.state != 0

    def factory(self):
        """Reset every setting to its default."""
        for entry in SETTINGS:
            setattr(self, entry[1], entry[4])

    def load(self, values):
        """Reset to defaults, then apply these (name, value) pairs."""
        inverted = self.inverted
        self.factory()
        for name, value in values:
            setattr(self, name, value)
        if self.inverted != inverted:
            self.position.mirror()
        self.apply()

    def can_fit(self, switches):
        """True if the board has inputs for these switches (bits as in settings.py)."""
        return not (
            switches & ~3
            or (switches & 1 and not self.positive_stop.can_fit())
            or (switches & 2 and not self.negative_stop.can_fit())
        )

    def set(self, name, value):
        """Change the setting of this name to an allowed value."""
        if name == "inverted" and value != self.inverted:
            self.position.mirror()  # and the soft limits stay where they are
            self.soft_minimum, self.soft_maximum = -self.soft_maximum, -self.soft_minimum
        setattr(self, name, value)
        self.apply()

    def apply(self):
        """Apply changed settings."""
        self.changed = self.moving()
        self.positive_stop.fitted = self.switches & 1 != 0
        self.negative_stop.fitted = self.switches & 2 != 0
        self.watched = self.switches & 3 != 0 and not self.checking & 1
        if not self.changed:
            self.measure()

    def measure(self):
        """Compute the amounts of drive that make a step, and the gap."""
        step = self.pulse_us * self.step_duty
        if step != self.position.step:
            self.position.step_changed()
            self.position.step = step
        self.position.set_gap(self.take_up_us * self.step_duty)

    def possible_velocity(self):
        """Hundredths of a step per second: `velocity`, or less if that leaves no room for pulses and rests.

        Then rounded down to whole steps if it is one at least: drivers of the dialect read whole numbers.
        """
        most = 100_000_000 // (self.pulse_us + _REST_US)
        if self.velocity <= most:
            return self.velocity
        return most // 100 * 100 or most

    # ---- the end-stops

    def limits(self):
        """Bit 0: positive end-stop active, bit 1: negative, bit 2: home. Switches not fitted read 0."""
        bits = (1 if self.positive_stop.active() else 0) | (2 if self.negative_stop.active() else 0)
        if self.inverted:  # the switches stay with the electrical direction; their names swap
            bits = (bits & 1) << 1 | bits >> 1
        return bits

    def stop_towards(self, direction):
        """The end-stop that lies in the axis's own direction 1 or -1."""
        return self.positive_stop if (direction > 0) != (self.inverted > 0) else self.negative_stop
