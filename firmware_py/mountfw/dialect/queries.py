"""The answers to queries. Each query adds the parts of its answer to a Replies. Imports codes."""

from mountfw import __version__, codes
from mountfw.motion.position import rounded
from mountfw.settings import MAX_STEPS

_VERSION = __version__.encode()


class About:
    """Facts of the board: board (its name) is bytes, reset_cause is a number of codes.py, the others are the port's.

    firmware_hash() yields None after each part of its work, and last the hash; free_memory() is the heap's free bytes.
    boot_id (0 ... 2**30-1) differs from start to start.
    """

    def __init__(self, board, port, reset_cause):
        self.identity = b"mirrormount," + board + b"," + port.unique_id() + b"," + _VERSION
        self.firmware_hash = port.firmware_hash
        self.reset_cause = reset_cause
        self.free_memory = port.free_memory
        self.boot_id = port.boot_id()
        self.power = None  # reads the analog input, 0 ... 65535; None: not fitted
        self._ticks_ms = port.ticks_ms
        self._booted_ms = port.ticks_ms()
        self.gate = 0  # as the port's gate says (docs/gate.md); 0: this port has none
        self.passes = 0  # of the loop
        self.longest_us = 0  # of them since XH? was asked; -1: the very pass that answers it does not count

    def restarted(self):
        """From here on it is as after another start."""
        self.boot_id = self.boot_id + 1 & 0x3FFFFFFF
        self._booted_ms = self._ticks_ms()

    def passed(self, us):
        """A pass of the loop has taken so long."""
        self.passes = self.passes + 1 & 0x3FFFFFFF
        if us > self.longest_us:
            self.longest_us = us if self.longest_us >= 0 else 0

    def uptime_ms(self):
        """Since the start, or the restart; wraps at 2**30."""
        return (self._ticks_ms() - self._booted_ms) & 0x3FFFFFFF


class Queries:
    """One method a query; axis is the query's Axis, or None."""

    def __init__(self, controller, replies, about):
        self._controller = controller
        self._replies = replies
        self.about = about
        self.hash = None  # of the firmware's files; None: they are not read to the end
        self._hashing = about.firmware_hash()
        self._free = 0  # bytes of memory; 0: not counted yet

    # ---- motion

    def relative(self, axis):
        self._replies.add(axis.last_relative)

    def target(self, axis):
        self._replies.add(axis.position.target)

    def position(self, axis):
        self._replies.add(max(-MAX_STEPS, min(MAX_STEPS, rounded(axis.position_now()))))  # a run may end beyond

    def defined(self, axis):
        self._replies.add(axis.position.defined)

    def done(self, axis):
        self._replies.add(0 if axis.moving() else 1)

    def direction(self, axis):
        d = axis.direction()
        self._replies.add(b"+" if d > 0 else b"-" if d else b"0")

    def hundredths(self, n):
        """Add n hundredths (not negative) as a decimal number."""
        r = self._replies
        r.add(n // 100)
        part = n % 100
        if part:
            r.field(b".", part // 10)
            if part % 10:
                r.add(part % 10)

    def home_offset(self, axis):
        """Was it known where home was, and how many millisteps off was the count there?"""
        r = self._replies
        r.add(1 if axis.position.offset_known else 0)
        r.field(b",", axis.position.offset)

    def ended(self, axis):
        r = self._replies
        r.add(axis.reason)
        r.field(b",", axis.ended_steps)
        r.field(b",", axis.ended_on_us)

    # ---- the mount

    def limits(self, _axis):
        bits = 0  # three of each axis; axis 1 has the lowest
        for axis in self._controller.axes:
            bits = axis.limits() << axis.number * 3 - 3 | bits
        self._replies.add(bits)

    def keep_alive(self, _axis):
        self._replies.add(self._controller.keep_alive_ms)

    def status(self, _axis):
        r = self._replies
        r.add(self.about.boot_id)
        r.field(b",", self.about.uptime_ms())
        r.field(b",", self._controller.errors.waiting)
        for axis in self._controller.axes:
            axis.check_stop()
            self._status_of(axis)

    def _status_of(self, axis):
        """A stop that is read in the middle ends no move yet: position and `at rest` are of one moment."""
        r = self._replies
        position = axis.position_now()
        r.field(b"|", position)
        r.field(b",1," if axis.moving() else b",0,", axis.direction())
        r.field(b",", axis.limits())
        r.field(b",", axis.reason)
        r.field(b",", axis.position.certainty)

    def error(self, _axis):
        self._replies.add(self._controller.errors.pop())

    def error_text(self, _axis):
        code = self._controller.errors.pop()
        r = self._replies
        r.add(code)
        r.add(b", ")
        if code >= 100:
            r.field(b"AXIS ", code // 100)
            r.add(b" ")
        r.add(codes.message(code))

    # ---- the board

    def identity(self, _axis):
        self._replies.add(self.about.identity)

    def version(self, _axis):
        r = self._replies
        r.add(b"MM2 Version ")  # four words as on its controllers, and a short first one: clients count on both
        r.add(_VERSION)
        r.add(b" mirrormount")

    def read_files(self):
        """Read the next part of the firmware's files, for the hash."""
        try:
            self.hash = next(self._hashing)
        except OSError:
            self.hash = b"unreadable"

    def firmware_hash(self, _axis):
        self._replies.add(self.hash)

    def power(self, _axis):
        self._replies.add(self.about.power())

    def health(self, _axis):
        r = self._replies
        if not self._controller.driving():  # it walks the heap, 9 ms on a Pico: a pulse and a stop must not wait for it
            self._free = self.about.free_memory()
        r.add(self._free)
        r.field(b",", max(0, self.about.longest_us))
        r.field(b",", self.about.passes)
        r.field(b",", self.about.reset_cause)
        r.field(b",", self.about.gate)
        self.about.longest_us = -1
