"""The two axes together: what drives, what stops it, what watches over it. Imports axis, codes, ticks.

The app hands in what comes over the wire: frame(), stop_all(), malformed(). Command lines are for
commands.py, which acts on the same axes.
"""

from mountfw import codes
from mountfw.motion.axis import NEVER_US, REST
from mountfw.wire.ticks import diff


class Controller:
    """Axes 1 and 2. error_queue is shared with the axes; emergency_stop is an EndStop; records a Records.

    boot_id (0 ... 2**30-1) differs from boot to boot; ticks_ms is a millisecond clock that wraps at 2**30.
    """

    def __init__(self, axis1, axis2, error_queue, emergency_stop, records, boot_id, ticks_ms):
        self.axes = (axis1, axis2)
        self.errors = error_queue
        self.records = records
        self.boot_id = boot_id
        self._axis1 = axis1
        self._axis2 = axis2
        self._cut1 = axis1.bridge.cut
        self._cut2 = axis2.bridge.cut
        self._emergency_stop = emergency_stop
        self._ticks_ms = ticks_ms
        self._booted_ms = 0
        self.keep_alive_ms = 0
        self.heard_at = 0  # when the last byte came: whoever sent it was alive
        self.held = codes.NONE_YET
        self.look = records.look  # called in the middle of what takes long: a stop must not wait for it
        self.reset()

    # ---- what the app hands in

    def off_all(self):
        """Both drives off: straight-line pin writes, nothing else before the last enable is low."""
        self._cut1()
        self._cut2()
        self._axis1.bridge.off()
        self._axis2.bridge.off()

    def stop_all(self, reason):
        """Both drives off and every move ended."""
        self.off_all()
        self._axis1.end(reason)
        self._axis2.end(reason)

    def shutdown(self, reason=codes.FAULT):
        """Leave everything off. May be called again if it was interrupted; the first reason stays."""
        self.stop_all(reason)
        self.keep_alive_ms = 0

    def reset(self):
        """Off, and everything as at power-up; the link stays as it is."""
        self.off_all()
        self._axis1.reset()
        self._axis2.reset()
        self.hold(self.held)
        self.errors.clear()
        self.keep_alive_ms = 0
        self._booted_ms = self._ticks_ms()
        self.records.recall()
        self.records.restore()
        self.guard(None)

    def restart(self):
        """Off, every move ended, and as at power-up with a new boot id."""
        self.stop_all(codes.ABORTED)
        self.boot_id = self.boot_id + 1 & 0x3FFFFFFF
        self.reset()

    def uptime_ms(self):
        """Since the start, or the restart; wraps at 2**30."""
        return (self._ticks_ms() - self._booted_ms) & 0x3FFFFFFF

    def watch_input(self, look):
        """look() takes in what waits at the input: to be called in the middle of what takes long."""
        self.look = look
        self.records.look = look

    def guard(self, _pin):
        """The emergency stop has opened (a hard interrupt, maybe): cut both drives, until reset()."""
        if self._emergency_stop.active():
            self._axis1.emergency = True
            self._axis2.emergency = True
            self._cut1()
            self._cut2()

    def guard_stops(self):
        """Look at the switches ahead, for a port without interrupts: what drives into one is cut."""
        a = self._axis1
        b = self._axis2
        if a.watched and a.state > REST and not a.was_cut:
            a.guard(None)
        if b.watched and b.state > REST and not b.was_cut:
            b.guard(None)

    def hold(self, reason):
        """A stop was received but is not yet parsed: nothing that comes before it may drive. NONE_YET lets go.

        What would have driven ends with that stop's reason.
        """
        self.held = reason
        self._axis1.held = reason
        self._axis2.held = reason

    def malformed(self, code):
        """A message could not be understood. It may have been a stop, so it stops."""
        self.stop_all(codes.STOPPED)
        self.errors.push(code)

    def suspect(self, m1, m2):
        """A frame that may be our own reply must wait; but what it turns off goes off now: no stop is late."""
        if m1 == 0:
            self._axis1.frame(0)
        if m2 == 0:
            self._axis2.frame(0)

    def frame(self, m1, m2):
        """Obey a frame."""
        if m1 == 0 and m2 == 0:
            self.stop_all(codes.STOPPED)
            return
        axis1 = self._axis1
        axis2 = self._axis2
        if m1 == 0:  # what goes off goes first
            axis1.frame(0)
        elif m2 == 0:
            axis2.frame(0)
        if m1:
            axis1.lead(m1)
            self.look()
        if m2:
            axis2.lead(m2)
        if m1:
            axis1.frame(m1)
            self.look()
        if m2:
            axis2.frame(m2)

    def service(self, now_us):
        """Carry the moves on. Returns the microseconds to the next deadline."""
        if self._emergency_stop.fitted:
            self.guard(None)
        a = self._axis1
        b = self._axis2
        left1_us = a.service(now_us) if a.state or a.resting else NEVER_US
        left2_us = b.service(now_us) if b.state or b.resting else NEVER_US
        return left1_us if left1_us < left2_us else left2_us

    def ending(self, now_us, within_us):
        """The Axis whose drive ends first of those that end by themselves within within_us; or None."""
        left1_us = self._axis1.left_us(now_us)
        left2_us = self._axis2.left_us(now_us)
        if left1_us < left2_us:
            return self._axis1 if left1_us < within_us else None
        return self._axis2 if left2_us < within_us else None

    def silence(self, now_us):
        """Nothing waits to be read: is the keep-alive over? Returns the microseconds it has left."""
        left_us = self.keep_alive_ms * 1000 - diff(now_us, self.heard_at)
        if left_us > 0:
            return left_us
        self.keep_alive_ms = 0  # a dead client's keep-alive does not cut the next one
        if self.moving():
            self.stop_all(codes.KEEP_ALIVE)
            self.errors.push(codes.KEEP_ALIVE_LOST)
        return NEVER_US

    def moving(self):
        """True while any axis moves."""
        return self._axis1.moving() or self._axis2.moving()

    def driving(self):
        """True while any motor has drive."""
        return self._axis1.state > REST or self._axis2.state > REST

    def watching(self):
        """True while a switch matters, so that the loop must not sleep."""
        watched = self._axis1.watched or self._axis2.watched or self._emergency_stop.fitted
        return watched and self.driving()
