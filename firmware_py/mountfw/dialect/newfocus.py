"""Commands of New Focus 8742/8743-CL controllers for parts that this mount has not. Imports codes, line.

Drivers written for these controllers send them at start-up: for a network, other motors, an encoder. They set
nothing, and a query answers as one unit without these parts would.
"""

from mountfw import codes, const
from mountfw.dialect.line import key

ADDRESS = const(1)  # of this controller, in a line that names one; 0 is the controller at the port, so this one as well
AXES = const(4)  # of such a controller; an axis that this mount has not answers as not connected

_ENCODER = ("SN", "MM", "DB", "CL", "FE", "XN", "XG", "XA", "XZ")  # SN, and ENCODER_SETTINGS


class NewFocus:
    """The rows of the command table for parts that this mount has not.

    line is the Line that is executed. number(line) says whether it carries a number, and queues an error if not.
    """

    def __init__(self, line, replies, number):
        self._line = line
        self._replies = replies
        self._number = number
        self._constants = {}

    def rows(self):
        """{mnemonic: (needs an axis, set, query)}, as in Commands."""
        constants = {
            "SA": b"%d" % ADDRESS,
            "SC": b"%d" % (1 << ADDRESS),  # a bit for each address that is in use
            "SD": b"1",
            "RS": b"0",
            "ZZ": b"0",
            "IPMODE": b"0",
            "HOSTNAME": b"mirrormount",
            "IPADDR": b"0.0.0.0",
            "GATEWAY": b"0.0.0.0",
            "NETMASK": b"0.0.0.0",
            "MACADDR": b"00,00,00,00,00,00",
        }
        self._constants = {key(name.encode()): answer for name, answer in constants.items()}
        rows = {"MC": (False, self._accept, None), "MZ": (True, self._accept, self._zero)}
        rows.update(dict.fromkeys(_ENCODER, (True, self._open_loop, self._zero)))
        rows.update(dict.fromkeys(constants, (False, self._accept, self._constant)))
        return rows

    def _accept(self, _axis, _line):
        pass

    def _open_loop(self, axis, line):
        """Accept 0, the open loop that this mount is. Everything else needs an encoder."""
        if self._number(line) and (line.whole or line.millionths):
            axis.error(codes.AXIS_NOT_FITTED)

    def _zero(self, _axis):
        self._replies.add(0)

    def _constant(self, _axis):
        self._replies.add(self._constants[self._line.name])
