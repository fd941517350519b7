"""The settings of one axis, and its end-stops. Imports position.

A new setting counts from the next move on: what a step and a gap are is measured when none is under way.
"""

from mountfw.motion.position import MAX_STEPS, Position

_REST_US = 1_000  # least rest after a pulse


class Parameters:
    """What an axis is set to. The two EndStops are named for the electrical direction."""

    def __init__(self, positive_stop, negative_stop):
        self.positive_stop = positive_stop
        self.negative_stop = negative_stop
        self.watched = False  # is there an end-stop to look at?
        self.changed = False  # in the middle of a move
        self.state = 0
        self.position = Position()

    def moving(self):
        """True from a move's acceptance to its last pulse's end."""
        return self.state != 0

    def factory(self):
        """The settings as they were made; their names stand in the table of settings.py."""
        self.pulse_us = 200_000
        self.step_duty = 255
        self.run_duty = 255
        self.take_up_us = 0
        self.inverted = 0
        self.switches = 0  # bit 0: the positive end-stop is fitted, bit 1: the negative one
        self.run_limit_ms = 10_000
        self.search_limit_ms = 120_000
        self.velocity = 200  # hundredths of a step per second, as asked for: see possible_velocity()
        self.acceleration = 100_000  # kept for those who ask: DC pulses do not ramp
        self.soft_minimum = -MAX_STEPS
        self.soft_maximum = MAX_STEPS
        # bit 0: end-stops are ignored, bit 1: the following error is (there is none), bit 3: soft limits are checked
        self.checking = 0
        self.motor_type = 3  # 0: none

    def load(self, values):
        """Have the settings as they were made, and of these (name, value) the value."""
        inverted = self.inverted
        self.factory()
        for name, value in values:
            setattr(self, name, value)
        if self.inverted != inverted:
            self.position.mirror()
        self.apply()

    def can_fit(self, switches):
        """True if the board has inputs for these switches (see factory())."""
        return not (
            switches & ~3
            or (switches & 1 and not self.positive_stop.can_fit())
            or (switches & 2 and not self.negative_stop.can_fit())
        )

    def set(self, name, value):
        """Change the setting of this name; value is within its limits."""
        if name == "inverted" and value != self.inverted:
            self.position.mirror()  # and the soft limits stay where they are
            self.soft_minimum, self.soft_maximum = -self.soft_maximum, -self.soft_minimum
        setattr(self, name, value)
        self.apply()

    def apply(self):
        """The settings have changed."""
        self.changed = self.moving()
        self.positive_stop.fitted = self.switches & 1 != 0
        self.negative_stop.fitted = self.switches & 2 != 0
        self.watched = self.switches & 3 != 0 and not self.checking & 1
        if not self.changed:
            self.measure()

    def measure(self):
        """What makes a step, and a gap."""
        step = self.pulse_us * self.step_duty
        if step != self.position.step:
            self.position.step_changed()
            self.position.step = step
        self.position.set_gap(self.take_up_us * self.step_duty)

    def possible_velocity(self):
        """Hundredths of a step per second: what was asked for, or as much of it as the pulses fit in.

        That is a whole number of steps if it is one at least, because drivers of the dialect read whole numbers.
        """
        most = 100_000_000 // (self.pulse_us + _REST_US)
        if self.velocity <= most:
            return self.velocity
        return most // 100 * 100 or most

    # ---- the end-stops

    def limits(self):
        """Bit 0: positive end-stop active, bit 1: negative, bit 2: home. Switches not fitted say 0."""
        bits = (1 if self.positive_stop.active() else 0) | (2 if self.negative_stop.active() else 0)
        if self.inverted:  # the switches stay with the electrical direction; their names swap
            bits = (bits & 1) << 1 | bits >> 1
        return bits

    def stop_towards(self, direction):
        """The end-stop that lies in the axis's own direction 1 or -1."""
        return self.positive_stop if (direction > 0) != (self.inverted > 0) else self.negative_stop
