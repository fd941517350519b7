"""All axes of a mount together: what drives, what stops it, what watches over it. Imports axis, codes, drive, ticks.

A frame drives axes 1 and 2; every stop is for all axes. Command lines go by dialect/commands.py to the same axes.
"""

from mountfw import codes, const
from mountfw.motion.axis import IDLE, REST
from mountfw.motion.drive import NEVER_US
from mountfw.wire.ticks import diff

_GUARD_US = const(64_000)  # a port without interrupts sees an emergency stop that opens for so long, at rest, too
_FAR_US = const(8_000)  # no drive ends before this, so there is time to read


class Controller:
    """The axes, two or more, in the order of their numbers. error_queue is shared with them."""

    def __init__(self, axes, error_queue, emergency_stop, records):
        self.axes = tuple(axes)
        self.errors = error_queue
        self.records = records
        self._axis1, self._axis2 = self.axes[:2]  # of a frame
        for axis, after in zip(self.axes, self.axes[1:] + (None,)):
            axis.next = after  # a `for` takes longer, and more words of a call's state than the C stack has
        self._cuts = tuple([axis.drive.bridge.cut for axis in axes])
        self._releases = tuple([axis.drive.bridge.release for axis in axes])
        self._emergency_stop = emergency_stop
        self.inhibited = codes.NONE_YET  # the reason of a stop that is received but still unparsed
        self.halted = codes.NONE_YET  # the same until the axes are told: service() does
        self.reset()

    def off_all(self):
        """All drives off: nothing but pin writes before the last enable is low."""
        for cut in self._cuts:
            cut()
        for release in self._releases:
            release()

    def halt(self, reason):
        """A stop is received, maybe in the middle of longer work: cut all drives now; service() ends the moves."""
        self.off_all()
        for axis in self.axes:
            axis.drive.halt()
        self.inhibit(reason)
        self.halted = self.halted or reason

    def stop_all(self, reason):
        """All drives off and every move ended."""
        self.off_all()
        self.halted = codes.NONE_YET
        for axis in self.axes:
            axis.abort(reason)

    def shutdown(self, reason=codes.FAULT):
        """Leave everything off. May be called again if it was interrupted; the first reason stays."""
        self.stop_all(reason)
        self.keep_alive_ms = 0

    def reset(self):
        """Off, and everything as at power-up; the link stays as it is."""
        self.off_all()
        for axis in self.axes:
            axis.reset()
        self.inhibit(self.inhibited)
        self.errors.clear()
        self.keep_alive_ms = 0
        self.records.recall()
        self.records.restore()
        self.guard(None)

    def guard(self, _pin):
        """The emergency stop has opened (a hard interrupt, maybe): cut all drives, until reset()."""
        if self._emergency_stop.active():
            for axis in self.axes:
                axis.drive.emergency = True
            for cut in self._cuts:
                cut()

    def guard_stops(self):
        """Look at the switches ahead, for a port without interrupts: what drives into one is cut."""
        for axis in self.axes:
            if axis.drive.watched and axis.state > REST and not axis.drive.was_cut:
                axis.drive.guard(None)

    def inhibit(self, reason):
        """Inhibit motion by a stop that is received but still unparsed: moves end with its reason. NONE_YET: permit."""
        self.inhibited = reason
        for axis in self.axes:
            axis.drive.inhibited = reason

    def malformed(self, code):
        """A message could not be understood. It may have been a stop, so it stops."""
        self.stop_all(codes.STOPPED)
        self.errors.push(code)

    def frame(self, m1, m2):
        """Obey a frame: the speeds of axes 1 and 2. Two zeros are a stop, so they are for all axes."""
        if m1 == 0 and m2 == 0:
            self.stop_all(codes.STOPPED)
            return
        if m1 == 0:  # what goes off goes first
            self._axis1.frame(0)
        if m2 == 0:
            self._axis2.frame(0)
        if m1:
            self._axis1.drive.begin(m1)
        if m2:
            self._axis2.drive.begin(m2)
        if m1:
            self._axis1.frame(m1)
        if m2:
            self._axis2.frame(m2)

    def service(self, now_us):
        """Carry the moves on. Returns the microseconds to the next deadline."""
        least_us = NEVER_US
        if self._emergency_stop.fitted:
            self.guard(None)
            least_us = _GUARD_US
        if self.halted:
            self.stop_all(self.halted)
        axis = self._axis1
        while axis is not None and not self.halted:
            if axis.state or axis.resting or axis.position.closed:
                left_us = axis.service(now_us)
                if left_us < least_us:
                    least_us = left_us
                if axis.next and least_us > _FAR_US:
                    axis.check_stop()  # a stop does not wait for every axis
            axis = axis.next
        return least_us

    def ending(self, now_us, within_us):
        """The Axis whose drive ends first of those that end by themselves within within_us; or None."""
        first = None
        axis = self._axis1
        while axis is not None:
            drive = axis.drive
            if drive.measuring and not drive.was_cut:
                left_us = diff(drive.ends_at, now_us)
                if left_us < within_us:
                    within_us = left_us
                    first = axis
            axis = axis.next
        return first

    def silence(self, now_us, received_at):
        """No byte has come since received_at: is the keep-alive over? Returns the microseconds it has left."""
        left_us = self.keep_alive_ms * 1000 - diff(now_us, received_at)
        if left_us > 0:
            return left_us
        self.keep_alive_ms = 0  # a dead client's keep-alive does not cut the next one
        if self.moving():
            self.stop_all(codes.KEEP_ALIVE)
            self.errors.push(codes.KEEP_ALIVE_LOST)
        return NEVER_US

    def moving(self):
        """True while any axis moves."""
        return self.driving(IDLE)

    def driving(self, above=REST):
        """True while any motor has drive."""
        axis = self._axis1
        while axis is not None and axis.state <= above:
            axis = axis.next
        return axis is not None

    def watching(self):
        """True while a switch matters, so that the loop must not sleep."""
        axis = self._axis1
        while axis is not None and (axis.state <= REST or not (axis.drive.watched or self._emergency_stop.fitted)):
            axis = axis.next
        return axis is not None
