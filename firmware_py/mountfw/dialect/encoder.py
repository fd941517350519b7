"""The dialect's words for a closed loop, on a board with an encoder. Imports codes, line, settings of both kinds.

Without one, newfocus.py answers them. On an axis without one, so does this.
"""

from mountfw import codes, const
from mountfw.dialect.line import HUGE, NOTHING, key
from mountfw.encoder.settings import ENCODER_SETTINGS

SETTINGS = {key(entry[0]): entry for entry in ENCODER_SETTINGS}
_HALF = const(0x80000)  # XC? wraps at 2**19: no answer may begin like a frame (wire/replies.py)
_MASK = const(0xFFFFF)
_NEED_COUNTS = (key(b"MM"), key(b"SN"))
_UNCHECKED = const(1)  # bit of ZZ


class EncoderWords:
    """The rows of the command table: {mnemonic: (needs an axis, set, query)}, as in Commands, which has the others.

    axes are all axes; line is the Line that is executed; number(line) says whether it carries a number, and queues an
    error if not; set_any(axis, line) and ask_any(axis) execute a setting; rows are those of Commands.
    """

    def __init__(self, axes, line, replies, number, set_any, ask_any, rows):
        self._axes = axes
        self._line = line
        self._replies = replies
        self._number = number
        self._set_any = set_any
        self._ask_any = ask_any
        self._steps = {name: rows[name] for name in ("PR", "PA", "TP", "DH")}

    def rows(self):
        """Those that differ from a board's without an encoder."""
        rows = {
            "XC": (True, None, self._raw),
            "ZZ": (False, self._configure, self._configuration),
            "PR": (True, self._move_by, self._last_relative),
            "PA": (True, self._move_to, self._target),
            "TP": (True, None, self._position),
            "DH": (True, self._define, self._defined),
        }
        names = [entry[0].decode() for entry in ENCODER_SETTINGS]
        rows.update(dict.fromkeys(names, (True, self._set, self._ask)))
        return rows

    # ---- settings

    def _set(self, axis, line):
        if not hasattr(axis, "reader"):
            if self._number(line) and (line.whole or line.millionths):
                axis.error(codes.AXIS_NOT_FITTED)
        elif line.name in _NEED_COUNTS and line.whole and not axis.counts_per_step:
            axis.error(codes.AXIS_NOT_FITTED)
        else:
            self._set_any(axis, line)

    def _ask(self, axis):
        if hasattr(axis, "reader"):
            self._ask_any(axis)
        else:
            self._replies.add(0)

    def _raw(self, axis):
        if hasattr(axis, "reader"):
            counts = axis.reader.counts()
            error = codes.AXIS_ENCODER_LOST if axis.reader.gone else 0  # what it said last is no answer
        else:
            counts = 0
            error = codes.AXIS_NOT_FITTED
        if error:
            axis.error(error)
            self._replies.add(b"ERROR ")
            self._replies.add(axis.number * 100 + error)
        else:
            self._replies.add((counts + _HALF & _MASK) - _HALF)

    def _configure(self, axis, line):
        """Bit 0: no motor is checked when it is to move, so no drive is watched for a stall. Others mean nothing."""
        if self._number(line):
            axis = self._axes[0]
            while axis:
                if hasattr(axis, "reader"):
                    axis.check_motor(not line.rounded() & _UNCHECKED)
                axis = axis.next

    def _configuration(self, axis):
        axis = self._axes[0]
        while axis and not getattr(axis, "unchecked", False):
            axis = axis.next
        self._replies.add(_UNCHECKED if axis else 0)

    # ---- counts instead of steps

    def _move_by(self, axis, line):
        if not getattr(axis, "units", 0):
            self._steps["PR"][1](axis, line)
        elif self._counts(axis, line):
            axis.in_counts.move_by(line.rounded())

    def _move_to(self, axis, line):
        if not getattr(axis, "units", 0):
            self._steps["PA"][1](axis, line)
        elif self._counts(axis, line):
            axis.in_counts.move_to(line.rounded())

    def _define(self, axis, line):
        if not getattr(axis, "units", 0):
            self._steps["DH"][1](axis, line)
        elif line.kind == NOTHING or self._counts(axis, line):
            axis.in_counts.define(line.rounded())

    def _counts(self, axis, line):
        """Does the line carry a number of counts? HUGE stands for larger ones, which are refused."""
        if not self._number(line):
            return False
        if line.whole >= HUGE:
            axis.error(codes.AXIS_OUT_OF_RANGE)
        return line.whole < HUGE

    def _last_relative(self, axis):
        self._in_units("PR", axis, "relative")

    def _target(self, axis):
        self._in_units("PA", axis, "target")

    def _defined(self, axis):
        self._in_units("DH", axis, "defined")

    def _position(self, axis):
        if getattr(axis, "units", 0):
            self._replies.add(axis.in_counts.now())
        else:
            self._steps["TP"][2](axis)

    def _in_units(self, name, axis, counts):
        if getattr(axis, "units", 0):
            self._replies.add(getattr(axis.in_counts, counts))
        else:
            self._steps[name][2](axis)
