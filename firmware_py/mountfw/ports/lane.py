"""The fast lane: an input that drives at a frame as soon as its last byte is there. docs/gate.md explains it.

The port's read() notes in the log which frames have driven since when; book() counts that, as if the core had executed
each at its time. A port without native code has none: app.Input, and the core executes the frames.
"""

from array import array

from mountfw import codes, const
from mountfw.motion.axis import FRAME, RUN
from mountfw.wire.ticks import diff

_MOST = const(20)  # frames in the log
# places in the log: how many frames it has; from _FIRST on the packed frames, each with the times at which axis 1 and
# axis 2 got its speeds; before _FIRST a drive that the first of them has ended
_WAITING = const(0)
_FIRST = const(4)
_EACH = const(3)
_LINGER_US = const(12_000)  # so long frames of a stream wait to be counted, at most ...
_LONG_MS = const(100)  # ... where a run may take this or more


class Lane:
    """The input of a port with native code, as an app.Input, of a controller's first two axes. The port adds read()."""

    def __init__(self, controller, receiver, frame, replies, commands):
        self.axes = controller.axes[:2]
        self.receiver = receiver
        self.commands = commands  # no frame is taken while they are busy
        self.woke_at = 0
        self.which = 0  # 0 or 1: the axis whose frames are being booked, ...
        self.last = 0  # ... the number of the last one ...
        self.until = 0  # ... and up to when those before it drove
        self.log = array("i", [0] * (_FIRST + _EACH * _MOST))
        self._controller = controller
        self._frame = frame
        self._replies = replies
        self.check_stop = bool  # nothing: the App sets its own

    def book(self):
        """As of an Input; and echo a frame that came alone."""
        if not self.log[_WAITING]:
            return False
        self.last = self.log[_WAITING] - 1
        packed = self.log[_FIRST + _EACH * self.last]
        self._frame.unpack(packed)
        self._book(0, self._frame.m1)
        self._book(1, self._frame.m2)
        self.log[_WAITING] = 0
        if not self.last:
            self._replies.echo(packed)  # best effort: one that does not fit is dropped
        return True

    def linger(self):
        """In a stream, read() has taken a frame: for so many us it may wait for more before they are booked.

        Each frame sets the deadlines of both axes anew. Frames are a stream if the last booking had two or more (`last`
        is not 0).
        """
        if self.axes[1].next:
            return 1
        for axis in self.axes:
            if axis.position.closed or axis.run_limit_ms < _LONG_MS or (axis.state and axis.state != RUN):
                return 1
        return _LINGER_US

    def _book(self, which, speed):
        """Count what axis 1 (which: 0) or 2 (which: 1) has driven since the last frame, at that frame's speed."""
        self.which = which
        axis = self.axes[which]
        drive = axis.drive
        first = 0  # the first frame that this axis had to do with
        if not axis.state:
            while first < self.last and not self._speed(first):
                first += 1
            if not speed and first == self.last:  # it was off, and is
                return
        if first < self.last:
            self._supersede(axis, first)
        at = self.log[_FIRST + _EACH * self.last + 1 + which]
        if speed:
            drive.has_begun = True
            drive.began_at = at
        elif drive.measuring and (not drive.was_cut or diff(drive.cut_at, at) > 0):
            drive.cut()
            drive.cut_at = at  # and not later, by a stop behind it
        axis.frame(speed)
        self.check_stop()

    def _supersede(self, axis, first):
        """Count an axis's part from frame `first` on, but for the last: each was superseded by the next one."""
        drive = axis.drive
        # the gate may have cut it, and so may a stop behind the frames
        self.until = drive.halted_at if self._controller.halted else drive.clock()
        drive.has_begun = True
        drive.began_at = self.log[_FIRST + _EACH * first + 1 + self.which]
        # what was under way ended then; the frame that is the last ends it in the table, too
        if axis.state != RUN:
            axis.handle(FRAME, 1)
            axis.position.made = axis.ended_steps  # the last move that ended is the one to tell of
            drive.on_us = axis.ended_on_us
        elif drive.was_cut or axis.position.closed or not self._speed(first):
            axis.counting = True
            axis.count(True)
            axis.counting = False
        else:  # the run from before these frames is summed with them, from when it was counted last
            first -= 1
            n = drive.duty if drive.direction > 0 else drive.duty | 0x200
            self.log[_FIRST - _EACH] = n if self.which else n << 10
            self.log[_FIRST - _EACH + 1 + self.which] = drive.counted_at
        drive.has_begun = drive.measuring = False
        if axis.position.closed:
            first = self.last - 1  # one look at the encoder has seen them all
        self.check_stop()
        self.sum(axis, first)

    def _speed(self, i):
        n = self.log[_FIRST + _EACH * i] >> (0 if self.which else 10)
        return -(n & 0xFF) if n & 0x200 else n & 0xFF

    def sum(self, axis, i):
        """Count an axis's speeds from frame i on, but for the last, each until the next one, none after `until`."""
        while i < self.last:
            speed = self._speed(i)
            if speed:
                axis.drive.on_us = self._drove_us(_FIRST + _EACH * i + 1 + self.which)
                self.check_stop()
                axis.position.begin()
                if not axis.position.closed:
                    axis.position.driven(1 if speed > 0 else -1, axis.drive.on_us * abs(speed), True)
            i += 1

    def _drove_us(self, place):
        """How long the frame whose time is at this place of the log drove."""
        at = self.log[place]
        return max(0, min(diff(self.log[place + _EACH], at), diff(self.until, at)))

    def lose(self):
        """Ctrl-C, or a fault, has come between a frame's drive and its count: where the axes are is not known."""
        for axis in self.axes:
            if self.log[_WAITING] or axis.drive.has_begun:
                axis.drive.has_begun = False
                axis.position.certainty = codes.UNKNOWN
        self.log[_WAITING] = 0
