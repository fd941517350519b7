"""The command set: each command of a line is executed here. Imports codes, line, newfocus, queries, settings.

A line is executed piece by piece: go_on() does one of them, while busy is set. Answers go
to a Replies, errors to an ErrorQueue. The table in __init__ is the command set: each command
says whether it needs an axis, what sets it and what answers its query.
"""

from mountfw import codes
from mountfw.dialect import encoder
from mountfw.dialect.line import COMMAND, MINUS, NOTHING, NUMBER, PLUS, QUERY, key
from mountfw.dialect.newfocus import ADDRESS, AXES, NewFocus
from mountfw.dialect.queries import Queries
from mountfw.settings import AT_REST, HUNDREDTHS, MAX_STEPS, SETTINGS, allowed

_SETTINGS = {key(entry[0]): entry for entry in SETTINGS}
_PULSE = _SETTINGS[key(b"XP")]  # a pulse of its own length (XU) is as long as a step's may be
_VA = key(b"VA")
_MD = key(b"MD")
_XF = key(b"XF")
_XW = key(b"XW")
_ST = key(b"ST")
_STOPS = (_ST, key(b"AB"))


class Commands:
    """Executes a Line on a Controller's axes. about is an About."""

    def __init__(self, controller, line, replies, about):
        self.busy = False  # True while a line is executed
        self._controller = controller
        self._axes = controller.axes
        self._connected = len(controller.axes)
        self._records = controller.records
        self._replies = replies
        self._errors = controller.errors
        self._line = line
        self._read = False  # True if its next command is read and not yet executed
        self._stage = 0  # of a command that takes several pieces
        self._answers = 0  # of this line so far
        self._elsewhere = False  # True if it is addressed to another controller
        self.queries = queries = Queries(controller, replies, about)
        # (needs an axis, set, query); set(axis, line) and query(axis) of the axis, or of None
        commands = {
            "*IDN": (False, None, queries.identity),
            "*RST": (False, self._restart, None),
            "*RCL": (False, self._recall, None),
            "SM": (False, self._save, None),
            "XX": (False, self._purge, None),
            "VE": (False, self._version, queries.version),
            "PR": (True, self._move_by, queries.relative),
            "PA": (True, self._move_to, queries.target),
            "TP": (True, None, queries.position),
            "MD": (True, None, queries.done),
            "MV": (True, self._run, queries.direction),
            "MT": (True, self._find_stop, None),
            "OR": (True, self._home, queries.home_offset),
            "ST": (False, self._stop, None),
            "AB": (False, self._abort, None),
            "DH": (True, self._define, queries.defined),
            "TE": (False, None, queries.error),
            "TB": (False, None, queries.error_text),
            "PH": (False, None, queries.limits),
            "XK": (False, self._keep_alive, queries.keep_alive),
            "XU": (True, self._pulse, None),
            "XS": (False, None, queries.status),
            "XE": (True, None, queries.ended),
            "XF": (False, None, queries.firmware_hash),
            "XH": (False, None, queries.health),
            "XW": (False, None, queries.power),
        }
        commands.update(NewFocus(line, replies, self._number).rows())
        self._settings = _SETTINGS
        for axis in self._axes:
            if hasattr(axis, "reader") and self._settings is _SETTINGS:
                self._settings = dict(_SETTINGS)
                self._settings.update(encoder.SETTINGS)
                parts = (self._number, self._set, self._ask_setting)
                commands.update(encoder.EncoderWords(self._axes, line, replies, *parts).rows())
        self._commands = {key(name.encode()): entry for name, entry in commands.items()}
        self._commands.update(dict.fromkeys(_SETTINGS, (True, self._set, self._ask_setting)))

    # ---- a line

    def start(self):
        """Start to execute the line, which is complete and good. Its queries are answered in one line."""
        self._line.rewind()
        self._answers = 0
        self._stage = 0
        self._read = False
        self.busy = True
        self._elsewhere = self._line.address() > ADDRESS
        if self._elsewhere:
            self._errors.push(codes.NO_SUCH_CONTROLLER)
        self.go_on()  # only reads

    def go_on(self):
        """Do one piece: read some bytes of the line, or execute a command or a piece of it. The last ends the line."""
        line = self._line
        if self._read:
            self._read = False  # what fails within is not begun again
            self._read = self._execute(line) is True
        else:
            self._read = line.advance() == COMMAND
            if not self._read and line.more():
                self._read = line.advance() == COMMAND
        if self._read or line.more():
            return
        self.busy = False
        if self._answers:
            self._replies.add(b"\r\n")
            if not self._replies.commit():
                self._errors.push(codes.ANSWER_DROPPED)

    def _execute(self, line):
        """Do the command that was read. True if it is to be called again: there is more to do."""
        if self._elsewhere and (line.kind == QUERY or line.name not in _STOPS):
            return None  # a stop stops, whoever it is for
        entry = self._commands.get(line.name)
        if entry is None:
            return self._refuse(codes.NO_SUCH_COMMAND)
        action = entry[2] if line.kind == QUERY else entry[1]
        if action is None:
            return self._refuse(codes.NO_SUCH_COMMAND)
        axis = None
        if entry[0] or (line.axis >= 0 and line.kind != QUERY):
            if line.axis < 0:
                return self._refuse(codes.AXIS_MISSING)
            if not 1 <= line.axis <= AXES:
                return self._refuse(codes.NO_SUCH_AXIS)
            if line.axis > self._connected:
                return self._not_connected(line)
            axis = self._axes[line.axis - 1]
        if line.kind == QUERY:
            if line.name == _XF and self.queries.hash is None:
                return self._read_files()
            if line.name == _XW and self.queries.about.power is None:
                return self._refuse(codes.NO_POWER_PIN)
            self._next_answer()
            return action(axis)
        return action(axis, line)

    def _read_files(self):
        """Read a part of the firmware's files for XF?, at rest: it takes milliseconds. True: there is more to do."""
        for axis in self._axes:
            if axis.moving():
                return self._refuse(axis.number * 100 + codes.AXIS_MOVING)
        self.queries.read_files()
        return True

    def _refuse(self, code):
        """Queue an error; a query is answered with its number, so that a client does not wait in vain."""
        self._errors.push(code)
        if self._line.kind == QUERY:
            self._next_answer()
            self._replies.add(b"ERROR ")
            self._replies.add(code)

    def _not_connected(self, line):
        if line.kind == QUERY:
            self._next_answer()
            self._replies.add(1 if line.name == _MD else 0)
        elif line.name == _ST:  # drivers stop all four in turn, and there it is done: errors would fill the queue
            self._nothing(line)
        else:
            self._errors.push(line.axis * 100 + codes.AXIS_NOT_CONNECTED)

    def _next_answer(self):
        r = self._replies
        if self._answers:
            r.add(b"; ")
        else:
            r.begin()
            for i in range(self._line.address_length):
                c = self._line.text[i]  # digits, spaces and the `>`
                r.add(b">" if c == 0x3E else b" " if c == 0x20 else c - 0x30)
        self._answers += 1

    # ---- values

    def _number(self, line):
        """True if the command carries a number; else its error is queued."""
        if line.kind == NUMBER:
            return True
        self._errors.push(codes.VALUE_MISSING if line.kind == NOTHING else codes.OUT_OF_RANGE)
        return False

    def _integer(self, line, least, most):
        """True if the command carries a whole number within least ... most."""
        if not self._number(line):
            return False
        if line.millionths == 0 and least <= line.rounded() <= most:
            return True
        self._errors.push(codes.OUT_OF_RANGE)
        return False

    def _sign(self, line):
        """1 or -1 if the command carries a sign; else 0, and its error is queued."""
        if line.kind == PLUS or line.kind == MINUS:
            return 1 if line.kind == PLUS else -1
        self._errors.push(codes.VALUE_MISSING if line.kind == NOTHING else codes.OUT_OF_RANGE)
        return 0

    def _nothing(self, line):
        """True if the command carries no value; else its error is queued."""
        if line.kind != NOTHING:
            self._errors.push(codes.OUT_OF_RANGE)
        return line.kind == NOTHING

    def _refused(self, axis):
        if axis.moving():
            axis.error(codes.AXIS_MOVING)
            return True
        return False

    def _any_moves(self):
        refused = False  # an error for the first that moves
        for axis in self._axes:
            refused = refused or self._refused(axis)
        return refused

    # ---- motion

    def _move_by(self, axis, line):
        if self._number(line):
            axis.steps(line.rounded())

    def _pulse(self, axis, line):
        if self._integer(line, -_PULSE[3], _PULSE[3]):
            us = line.rounded()
            if abs(us) < _PULSE[2]:
                self._errors.push(codes.OUT_OF_RANGE)
            else:
                axis.one_pulse(us)

    def _move_to(self, axis, line):
        if self._number(line):
            axis.move_to(line.rounded())

    def _run(self, axis, line):
        sign = self._sign(line)
        if sign:
            axis.jog(sign)

    def _find_stop(self, axis, line):
        sign = self._sign(line)
        if sign:
            axis.seek(sign, False)

    def _home(self, axis, line):
        """Home is the negative end-stop; the positive one where that is the only one."""
        if self._nothing(line):
            axis.seek(-1 if axis.stop_towards(-1).fitted or not axis.stop_towards(1).fitted else 1, True)

    def _stop(self, axis, line):
        self._nothing(line)  # stopped all the same: a damaged stop must stop
        for each in self._axes:
            if axis is None or axis is each:
                each.stop_soon()

    def _abort(self, _axis, line):
        self._nothing(line)
        self._controller.stop_all(codes.ABORTED)

    def _restart(self, _axis, line):
        if self._nothing(line):
            self._controller.stop_all(codes.ABORTED)
            self.queries.about.restarted()
            self._controller.reset()

    # ---- settings

    def _set(self, axis, line):
        entry = self._settings[line.name]
        if not (self._number(line) if entry[5] & HUNDREDTHS else self._integer(line, entry[2], entry[3])):
            return
        if entry[5] & AT_REST and self._refused(axis):
            return
        n = line.hundredths() if entry[5] & HUNDREDTHS else line.rounded()
        if not axis.has_parts_for(entry[1], n):
            axis.error(codes.AXIS_NOT_FITTED)
        elif not allowed(entry, n):
            self._errors.push(codes.OUT_OF_RANGE)
        else:
            axis.set(entry[1], n)
            if line.name == _VA and axis.possible_velocity() < n:  # kept: the pulses may become shorter
                axis.error(codes.AXIS_TOO_FAST)

    def _ask_setting(self, axis):
        entry = self._settings[self._line.name]
        if entry[5] & HUNDREDTHS:
            self.queries.hundredths(axis.possible_velocity() if self._line.name == _VA else getattr(axis, entry[1]))
        else:
            self._replies.add(getattr(axis, entry[1]))

    def _define(self, axis, line):
        if (line.kind != NOTHING and not self._number(line)) or self._refused(axis):
            return
        n = line.rounded()
        if not -MAX_STEPS <= n <= MAX_STEPS:
            axis.error(codes.AXIS_OUT_OF_RANGE)
        elif not axis.drive.on_flash or self._records.drop_record():  # the record would tell another number
            axis.position.define(n)
            axis.has_moved = True

    def _version(self, axis, line):
        """VE without `?`: its controllers answer that as well, and a driver asks so."""
        if self._nothing(line):
            self._next_answer()
            self.queries.version(axis)

    def _keep_alive(self, _axis, line):
        if self._integer(line, 0, 60_000):
            self._controller.keep_alive_ms = line.rounded()

    def _save(self, _axis, line):
        if self._stage == 0 and (not self._nothing(line) or self._any_moves()):
            return False
        self._stage = self._records.save(self._stage)
        return self._stage > 0

    def _purge(self, axis, line):
        """The settings as they were made, also on the flash."""
        if line.kind == NOTHING and not self._controller.moving():
            self._records.factory()
        return self._save(axis, line)  # which refuses it if it was not done

    def _recall(self, _axis, line):
        if self._integer(line, 0, 1) and not self._any_moves():
            if line.rounded():
                self._records.recall()
            else:
                self._records.factory()
