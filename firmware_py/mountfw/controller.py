"""The two axes behind one set of commands. Imports axis, command, errors.

The app hands messages in: frame(), line(), stop_all(), malformed(). A line is executed little by
little, by next_command() while busy is set. Answers go to a Replies, errors to an ErrorQueue. The
table at the end of __init__ is the command set: each command says whether it needs an axis, what sets
it and what answers its query.
"""

from mountfw import __version__, errors
from mountfw.axis import MAX_STEPS, NEVER_US, REST
from mountfw.command import COMMAND, END, MINUS, NOTHING, NUMBER, PLUS, QUERY, Line, key
from mountfw.ticks import diff

_CONNECTED = 2  # axes this mount has
_DIALECT_AXES = 4  # axes the dialect knows; those above _CONNECTED answer as not connected

# one axis's stored settings: attribute, least, most, whether it is refused while the axis moves
_PARAMETERS = {
    key(b"XP"): ("pulse_us", 200, 2_000_000, True),
    key(b"XD"): ("step_duty", 1, 255, False),
    key(b"XV"): ("run_duty", 1, 255, False),
    key(b"XI"): ("inverted", 0, 1, True),
    key(b"XM"): ("run_limit_ms", 1, 400_000, False),
    key(b"XT"): ("move_limit_ms", 1, 400_000, False),
    key(b"ZH"): ("checking", 0, 1, False),
}
_XP = key(b"XP")
_XD = key(b"XD")
_XI = key(b"XI")
_MD = key(b"MD")
_VERSION = __version__.encode()


def _no_look():
    pass


class Controller:
    """Axes 1 and 2. replies and error_queue are shared with the app and the axes.

    emergency_stop is an EndStop. board and unique_id (bytes) go into the identity; boot_id (0 ... 2**30-1)
    differs from boot to boot; ticks_ms is a millisecond clock that wraps at 2**30. firmware_hash (bytes) is
    answered as it is; reset_cause and what free_memory() gives, in bytes, are numbers of the health.
    """

    def __init__(
        self,
        axis1,
        axis2,
        replies,
        error_queue,
        emergency_stop,
        board,
        unique_id,
        boot_id,
        ticks_ms,
        firmware_hash,
        reset_cause,
        free_memory,
    ):
        self.axes = (axis1, axis2)
        self.errors = error_queue
        self._axis1 = axis1
        self._axis2 = axis2
        self._cut1 = axis1.bridge.cut
        self._cut2 = axis2.bridge.cut
        self._emergency_stop = emergency_stop
        self._replies = replies
        self._identity = b"mirrormount," + board + b"," + unique_id + b"," + _VERSION
        self._boot_id = boot_id
        self._ticks_ms = ticks_ms
        self._booted_ms = 0
        self._firmware_hash = firmware_hash
        self._reset_cause = reset_cause
        self._free_memory = free_memory
        self._free = free_memory()
        self._longest_us = 0  # pass of the loop since XH? was asked; -1: that very pass does not count
        self._passes = 0
        self.keep_alive_ms = 0
        self.heard_at = 0  # when the last byte came: whoever sent it was alive
        self.held = False
        self.look = _no_look  # called in the middle of what takes long: a stop must not wait for it
        self.busy = False  # is a line in hand?
        self._read = False  # is its next command read and to be executed?
        self._answers = 0  # of the line in hand
        self._line = Line()  # the line in hand
        # (needs an axis, set, query); set(axis, line) and query(axis) of the axis, or of None
        self._commands = {
            key(b"*IDN"): (False, None, self._ask_identity),
            key(b"*RST"): (False, self._set_reset, None),
            key(b"VE"): (False, None, self._ask_version),
            key(b"PR"): (True, self._set_relative, self._ask_relative),
            key(b"PA"): (True, self._set_absolute, self._ask_target),
            key(b"TP"): (True, None, self._ask_position),
            key(b"MD"): (True, None, self._ask_done),
            key(b"MV"): (True, self._set_run, self._ask_direction),
            key(b"ST"): (False, self._set_stop, None),
            key(b"AB"): (False, self._set_abort, None),
            key(b"DH"): (True, self._set_home, self._ask_home),
            key(b"VA"): (True, self._set_velocity, self._ask_velocity),
            key(b"TE"): (False, None, self._ask_error),
            key(b"TB"): (False, None, self._ask_error_text),
            key(b"PH"): (False, None, self._ask_limits),
            key(b"XL"): (True, self._set_fitted, self._ask_fitted),
            key(b"XK"): (False, self._set_keep_alive, self._ask_keep_alive),
            key(b"XS"): (False, None, self._ask_status),
            key(b"XE"): (True, None, self._ask_ended),
            key(b"XF"): (False, None, self._ask_firmware_hash),
            key(b"XH"): (False, None, self._ask_health),
        }
        for name in _PARAMETERS:
            self._commands[name] = (True, self._set_parameter, self._ask_parameter)
        self.reset()
        if reset_cause == errors.WATCHDOG:
            error_queue.push(errors.WATCHDOG_RESET)

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

    def shutdown(self, reason=errors.FAULT):
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
        self.guard(None)

    def guard(self, _pin):
        """The emergency stop has opened (a hard interrupt, maybe): cut both drives, until reset()."""
        if self._emergency_stop.active():
            self._axis1.emergency = True
            self._axis2.emergency = True
            self._cut1()
            self._cut2()

    def hold(self, held):
        """While a stop was received but not yet parsed, nothing that comes before it may drive."""
        self.held = held
        self._axis1.held = held
        self._axis2.held = held

    def malformed(self, code):
        """A message could not be understood. It may have been a stop, so it stops."""
        self.stop_all(errors.STOPPED)
        self.errors.push(code)

    def frame(self, m1, m2):
        """Obey a frame."""
        if m1 == 0 and m2 == 0:
            self.stop_all(errors.STOPPED)
            return
        axis1 = self._axis1
        axis2 = self._axis2
        if m1 == 0:  # what goes off goes first
            axis1.frame(0)
        elif m2 == 0:
            axis2.frame(0)
        if m1:
            axis1.lead(m1)
        if m2:
            axis2.lead(m2)
        self.look()
        if m1:
            axis1.frame(m1)
            self.look()
        if m2:
            axis2.frame(m2)

    def line(self, line):
        """A good line is in hand: next_command() executes it, and its queries are answered in one line."""
        self._line = line
        self._answers = 0
        line.rewind()
        self._read = False
        self.busy = True

    def next_command(self):
        """Go on with the line in hand: read a little of it, or execute one command, or end it."""
        if self._read:
            self._read = False
            self._execute(self._line)
            return
        found = self._line.advance()
        self._read = found == COMMAND
        if found != END:
            return
        self.busy = False
        if self._answers:
            self._replies.add(b"\r\n")
            if not self._replies.commit():
                self.errors.push(errors.ANSWER_DROPPED)

    def passed(self, us):
        """A pass of the loop took us microseconds."""
        self._passes = self._passes + 1 & 0x3FFFFFFF
        if us > self._longest_us:
            self._longest_us = us if self._longest_us >= 0 else 0

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
            self.stop_all(errors.KEEP_ALIVE)
            self.errors.push(errors.KEEP_ALIVE_LOST)
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

    # ---- one command

    def _execute(self, line):
        entry = self._commands.get(line.name)
        if entry is None:
            self.errors.push(errors.NO_SUCH_COMMAND)
            return
        action = entry[2] if line.kind == QUERY else entry[1]
        if action is None:
            self.errors.push(errors.NO_SUCH_COMMAND)
            return
        axis = None
        if entry[0] or (line.axis >= 0 and line.kind != QUERY):
            if line.axis < 0:
                self.errors.push(errors.AXIS_MISSING)
                return
            if not 1 <= line.axis <= _DIALECT_AXES:
                self.errors.push(errors.NO_SUCH_AXIS)
                return
            if line.axis > _CONNECTED:
                self._not_connected(line)
                return
            axis = self.axes[line.axis - 1]
        if line.kind == QUERY:
            self._next_answer()
            action(axis)
        else:
            action(axis, line)

    def _not_connected(self, line):
        if line.kind == QUERY:
            self._next_answer()
            self._replies.add(1 if line.name == _MD else 0)
        else:
            self.errors.push(line.axis * 100 + errors.AXIS_NOT_CONNECTED)

    def _next_answer(self):
        r = self._replies
        if self._answers:
            r.add(b"; ")
        else:
            r.begin()
            for i in range(self._line.address_length):
                r.put(self._line.text[i])
        self._answers += 1

    def _number(self, line):
        """True if the command carries a number; else its error is queued."""
        if line.kind == NUMBER:
            return True
        self.errors.push(errors.VALUE_MISSING if line.kind == NOTHING else errors.OUT_OF_RANGE)
        return False

    def _integer(self, line, least, most):
        """True if the command carries a whole number within least ... most."""
        if not self._number(line):
            return False
        if line.millionths == 0 and least <= line.rounded() <= most:
            return True
        self.errors.push(errors.OUT_OF_RANGE)
        return False

    def _refused(self, axis):
        if axis.moving():
            axis.error(errors.AXIS_MOVING)
            return True
        return False

    # ---- motion

    def _set_relative(self, axis, line):
        if self._number(line):
            axis.steps(line.rounded())

    def _set_absolute(self, axis, line):
        if self._number(line):
            axis.to(line.rounded())

    def _set_run(self, axis, line):
        if line.kind == PLUS or line.kind == MINUS:
            axis.run(-1 if line.kind == MINUS else 1)
        else:
            self.errors.push(errors.VALUE_MISSING if line.kind == NOTHING else errors.OUT_OF_RANGE)

    def _set_stop(self, axis, line):
        if line.kind != NOTHING:  # stopped all the same: a damaged stop must stop
            self.errors.push(errors.OUT_OF_RANGE)
        if axis is None:
            self._axis1.stop_soon()
            self._axis2.stop_soon()
        else:
            axis.stop_soon()

    def _set_abort(self, axis, line):
        if line.kind != NOTHING:
            self.errors.push(errors.OUT_OF_RANGE)
        self.stop_all(errors.ABORTED)

    def _set_reset(self, _axis, line):
        if line.kind != NOTHING:
            self.errors.push(errors.OUT_OF_RANGE)
            return
        self.stop_all(errors.ABORTED)
        self._boot_id = self._boot_id + 1 & 0x3FFFFFFF
        self.reset()

    def _ask_relative(self, axis):
        self._replies.add(axis.last_relative)

    def _ask_target(self, axis):
        self._replies.add(axis.target)

    def _ask_position(self, axis):
        self._replies.add(axis.whole_steps())

    def _ask_done(self, axis):
        self._replies.add(0 if axis.moving() else 1)

    def _ask_direction(self, axis):
        d = axis.direction()
        self._replies.add(b"+" if d > 0 else b"-" if d else b"0")

    # ---- settings

    def _set_parameter(self, axis, line):
        entry = _PARAMETERS[line.name]
        if not self._integer(line, entry[1], entry[2]) or (entry[3] and self._refused(axis)):
            return
        n = line.rounded()
        if line.name == _XI:
            axis.invert(n)
            return
        if (line.name == _XP or line.name == _XD) and getattr(axis, entry[0]) != n:
            axis.step_changed()
        setattr(axis, entry[0], n)
        axis.apply()

    def _ask_parameter(self, axis):
        self._replies.add(getattr(axis, _PARAMETERS[self._line.name][0]))

    def _set_home(self, axis, line):
        if line.kind != NOTHING and not self._number(line):
            return
        if self._refused(axis):
            return
        n = line.rounded()
        if -MAX_STEPS <= n <= MAX_STEPS:
            axis.define(n)
        else:
            axis.error(errors.AXIS_OUT_OF_RANGE)

    def _ask_home(self, axis):
        self._replies.add(axis.defined)

    def _set_velocity(self, axis, line):
        if not self._number(line):
            return
        n = line.hundredths()
        if n < 1:
            self.errors.push(errors.OUT_OF_RANGE)
        elif n > 100_000_000 // (axis.pulse_us + 1000):
            axis.error(errors.AXIS_TOO_FAST)
        else:
            axis.velocity = n

    def _ask_velocity(self, axis):
        r = self._replies
        r.add(axis.velocity // 100)
        part = axis.velocity % 100
        if part:
            r.add(b".")
            r.add(part // 10)
            if part % 10:
                r.add(part % 10)

    def _set_fitted(self, axis, line):
        if not self._integer(line, 0, 7) or self._refused(axis):
            return
        n = line.rounded()
        missing = (n & 1 and not axis.positive_stop.can_fit()) or (n & 2 and not axis.negative_stop.can_fit())
        if n & 4 or missing:
            axis.error(errors.AXIS_NOT_FITTED)
            return
        axis.fit(bool(n & 1), bool(n & 2))

    def _ask_fitted(self, axis):
        self._replies.add(axis.fitted())

    def _set_keep_alive(self, _axis, line):
        if self._integer(line, 0, 60_000):
            self.keep_alive_ms = line.rounded()

    def _ask_keep_alive(self, _axis):
        self._replies.add(self.keep_alive_ms)

    # ---- what it knows

    def _ask_identity(self, _axis):
        self._replies.add(self._identity)

    def _ask_version(self, _axis):
        self._replies.add(b"MM2 mirrormount ")
        self._replies.add(_VERSION)

    def _ask_error(self, _axis):
        self._replies.add(self.errors.pop())

    def _ask_error_text(self, _axis):
        code = self.errors.pop()
        r = self._replies
        r.add(code)
        r.add(b", ")
        if code >= 100:
            r.add(b"AXIS ")
            r.add(code // 100)
            r.add(b" ")
        r.add(errors.message(code))

    def _ask_limits(self, _axis):
        self._replies.add(self._axis1.limits() | self._axis2.limits() << 3)

    def _ask_status(self, _axis):
        r = self._replies
        r.add(self._boot_id)
        r.add(b",")
        r.add((self._ticks_ms() - self._booted_ms) & 0x3FFFFFFF)
        r.add(b",")
        r.add(self.errors.waiting)
        self._status_of(self._axis1)
        self.look()
        self._status_of(self._axis2)

    def _status_of(self, axis):
        r = self._replies
        r.add(b"|")
        r.add(axis.position_now())
        r.add(b",")
        r.add(1 if axis.moving() else 0)
        r.add(b",")
        r.add(axis.direction())
        r.add(b",")
        r.add(axis.limits())
        r.add(b",")
        r.add(axis.reason)
        r.add(b",")
        r.add(axis.certainty)

    def _ask_ended(self, axis):
        r = self._replies
        r.add(axis.reason)
        r.add(b",")
        r.add(axis.ended_steps)
        r.add(b",")
        r.add(axis.ended_on_us)

    def _ask_firmware_hash(self, _axis):
        self._replies.add(self._firmware_hash)

    def _ask_health(self, _axis):
        r = self._replies
        if not self.driving():  # it walks the heap, 8 ms on a Pico: a pulse and a stop must not wait for it
            self._free = self._free_memory()
        r.add(self._free)
        r.add(b",")
        r.add(self._longest_us if self._longest_us > 0 else 0)
        r.add(b",")
        r.add(self._passes)
        r.add(b",")
        r.add(self._reset_cause)
        self._longest_us = -1
