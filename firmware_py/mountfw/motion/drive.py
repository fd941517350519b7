"""The drive of one motor: may it, on, cut, a deadline, the measured on-time; and its end-stops. Imports codes, ticks.

A pulse, a run and a frame are one on() with its deadline; measured_us() returns how long the motor had drive. Only
_set(), and the input of a port that has its own, turn a motor on. The clock is read right before each pin write.
Between any two lines here an interrupt may run guard(), or set `emergency`: both only cut, on() checks again,
Axis.service() the rest.
"""

from mountfw import codes, const
from mountfw.wire.ticks import add, diff

NEVER_US = const(1 << 29)  # "no deadline"

_CLOCK_US = const(200)  # the last stretch reads the clock only: more than polling the input takes
_MOST_ON_US = const(1_000_000_000)  # a move's on-time is measured up to here: its sum stays a small integer


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


class Drive:
    """The drive on a bridge. stops[1] and stops[-1] are the EndStops in the axis's own direction 1 and -1."""

    def __init__(self, bridge, stops, ticks_us):
        self.bridge = bridge
        self._cut = bridge.cut
        self.stops = stops
        self._ticks_us = ticks_us
        self.gate = None  # of the port (docs/gate.md), while it is in place: it ends drives, too
        self.clock = ticks_us  # until when a drive that was not cut here was on: the gate may have cut it
        self.inverted = 0  # is the axis's positive direction the motor's negative one?
        self.watched = False  # is there an end-stop to look at?
        self.on_flash = False  # is the position recorded, or about to be? Then drop_record() comes first
        self.drop_record = bool  # nothing: store.py sets it
        self.direction = self.duty = 0  # of the next on(): 1 or -1; 1 ... 255
        self.on_us = 0  # measured since the move began
        self.on_at = 0  # when it was turned on
        self.ends_at = 0  # its deadline
        self.cut_at = self.halted_at = 0
        self.began_at = self.counted_at = 0  # the latter: up to when it was measured
        self.reset()

    def reset(self):
        """Off, and nothing forbids to drive."""
        self.bridge.release()
        self.inhibited = codes.NONE_YET  # the reason of a stop that is received but still unparsed
        self.emergency = False  # the emergency stop has opened; an interrupt may set it
        self.measuring = False  # is it on, or was it since measured_us()?
        self.was_cut = False  # is it off already, since cut_at?
        self.tripped = False  # did guard() cut it?
        self.has_begun = False  # did begin(), or the port's own input, turn it on at began_at? on() follows

    # ---- may it?

    def why_not(self):
        """The reason why it must not drive in its direction; 0 if it may. Drops the record of the position first."""
        if self.on_flash:
            self.drop_record()  # takes long, and polls the input: a stop may come of it
        if self.inhibited:
            return self.inhibited
        if self.emergency:
            return codes.EMERGENCY_STOP
        if self.on_flash:  # still: after a power cut that record would give a wrong position
            return codes.FAULT
        return codes.END_STOP if self.at_stop() else 0

    def at_stop(self):
        """True if the end-stop ahead is open, or has been since the move began to go there."""
        return self.watched and (self.tripped or self.stops[self.direction].active())

    # ---- on

    def aim(self, speed):
        """The next on() drives at speed, -255 ... 255 but not 0."""
        self.direction = 1 if speed > 0 else -1
        self.duty = speed * self.direction
        self.tripped = False

    def on(self, us):
        """Drive at duty in direction until cut, for us at most. Returns 0, or the reason why it must not drive.

        With a reason it may have been on for some microseconds: release() follows.
        """
        if self.has_begun:
            self.has_begun = False
            self.on_at = self.began_at
            self.was_cut = self.was_cut and self.inhibited != 0
            if self.was_cut:  # by a stop that came after it
                self.cut_at = self.halted_at
        else:
            if self.inhibited or self.emergency or self.watched or self.on_flash:
                reason = self.why_not()
                if reason:
                    return reason
            self.was_cut = False
            self.on_at = self._set(self.direction * self.duty)
        if not self.measuring:
            self.measuring = True
            self.counted_at = self.on_at
        self.ends_at = add(self.on_at, us)
        if self.gate:
            self.gate.end_at(self.ends_at)
        if self.tripped or self.inhibited or self.emergency:  # meanwhile, by an interrupt or a poll of the input
            return self.why_not()
        return 0

    def begin(self, speed):
        """Drive at a frame's speed (not 0) before it is counted, if nothing forbids it; Axis.frame() must follow."""
        if not (self.inhibited or self.emergency or self.watched or self.on_flash):
            self.began_at = self._set(speed)
            self.has_begun = True

    def _set(self, speed):
        """The one setter: drive at speed, -255 ... 255 but not 0, in the axis's own direction. Returns the time."""
        return self.bridge.drive(-speed if self.inverted else speed)

    # ---- off

    def release(self):
        """No drive, and every output in its defined state."""
        if self.measuring and not self.was_cut:
            self.cut()
        self.bridge.release()

    def cut(self):
        """No drive, since cut_at. A drive that is over may not be counted yet: its time stays."""
        self.cut_at = self.cut_at if self.was_cut else self.clock()
        self._cut()
        self.was_cut = True
        if self.gate:
            self.gate.ended()

    def halt(self):
        """A stop has cut: no drive since halted_at, not even one that is yet to be counted (has_begun)."""
        self.halted_at = self.clock()
        if not self.was_cut:
            self.cut_at = self.halted_at
            self.was_cut = True
            if self.gate:
                self.gate.ended()

    def end_on_time(self, check_stop, most):
        """Wait for the deadline, which must be near, and cut. Up to the last stretch check_stop(most) is called."""
        at_us = -1
        while not self.was_cut and at_us < 0:
            left_us = diff(self.ends_at, self._ticks_us())
            if left_us <= _CLOCK_US:
                at_us = self.bridge.cut_at(self.ends_at)
            if left_us > _CLOCK_US or (at_us < 0 and most > 1):  # a short drive (most is 1) must not be longer
                check_stop(most)
        if not self.was_cut:  # by a stop or by guard(), meanwhile
            self.cut_at = self.clock() if self.gate else at_us
            self.was_cut = True
            if self.gate:
                self.gate.ended()
        check_stop(most)

    def guard(self, _pin):
        """An end-stop has opened (a hard interrupt, maybe): cut the drive that goes into it."""
        if self.watched and self.stops[self.direction].active():
            self.tripped = True
            self.cut()

    # ---- time

    def measured_us(self, over):
        """On-time since it was measured last. over: this drive has ended, and the next on() begins a new one."""
        if not self.measuring:
            return 0
        at = self.cut_at if self.was_cut else self.clock()
        if self.has_begun and diff(at, self.began_at) > 0:  # since then it has the next frame's speed
            at = self.began_at
        us = max(0, diff(at, self.counted_at))  # it may have been cut right before it was turned on
        self.counted_at = at
        if over:
            self.measuring = False
        self.on_us = min(self.on_us + us, _MOST_ON_US)
        return us
