"""The dialect's words for a closed loop, on a board with an encoder. Imports codes, line, settings.

Without one, newfocus.py answers them. On an axis without one, so does this.
"""

from mountfw import codes, const
from mountfw.dialect.line import key
from mountfw.settings import ENCODER_SETTINGS

SETTINGS = {key(entry[0]): entry for entry in ENCODER_SETTINGS}
_CLOSED_LOOP = key(b"MM")
_HALF = const(0x80000)  # XC? wraps at 2**19: no answer may begin like a frame (wire/replies.py)
_MASK = const(0xFFFFF)
_UNCHECKED = const(1)  # bit of ZZ


class EncoderWords:
    """The rows of the command table: {mnemonic: (needs an axis, set, query)}, as in Commands, which has the others.

    axes are all axes; line is the Line that is executed; number(line) says whether it carries a number, and queues an
    error if not; set_any(axis, line) and ask_any(axis) execute a setting.
    """

    def __init__(self, axes, line, replies, number, set_any, ask_any):
        self._axes = axes
        self._line = line
        self._replies = replies
        self._number = number
        self._set_any = set_any
        self._ask_any = ask_any

    def rows(self):
        """Those that differ from a board's without an encoder."""
        rows = {
            "XC": (True, None, self._raw),
            "ZZ": (False, self._configure, self._configuration),
        }
        names = [entry[0].decode() for entry in ENCODER_SETTINGS]
        rows.update(dict.fromkeys(names, (True, self._set, self._ask)))
        return rows

    # ---- settings

    def _set(self, axis, line):
        if not hasattr(axis, "reader"):
            if self._number(line) and (line.whole or line.millionths):
                axis.error(codes.AXIS_NOT_FITTED)
        elif line.name == _CLOSED_LOOP and line.whole and not axis.counts_per_step:
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
