"""The grammar of a command line. Pure.

    [address>] [axis] MNEMONIC [value] {; [axis] MNEMONIC [value]} (CR or LF)

It is the dialect of New Focus 8742/8743-CL controllers. One automaton serves twice: fed as
the bytes arrive it refuses a line at the first byte that cannot continue it; when the line
has ended the same bytes run through it again and stop at each command. Nothing is executed
before the whole line was found good, and nothing is allocated.
"""

MORE = 0
COMMAND = 1  # inside a line: a `;` ended a command
END = 2  # a CR or LF ended the line, and its last command
BAD = -1
TOO_LONG = -2

MAX_LINE = 128

# what came after the mnemonic
NOTHING = 0
QUERY = 1
PLUS = 2
MINUS = 3
NUMBER = 4

_LF = 10
_CR = 13

# where in a command the automaton stands
_START = 0
_AXIS = 1  # digits: an axis, or at the start of the line an address
_AXIS_SPACE = 2
_NAME = 3
_NAME_SPACE = 4
_SIGN = 5
_WHOLE = 6
_POINT = 7
_DECIMALS = 8
_AFTER_VALUE = 9

_MAX_NAME = 6  # letters that fit an integer below 2**30 to the base 28


def key(name):
    """The integer that stands for a mnemonic (bytes, at most 6 letters, `*` allowed first)."""
    k = 0
    for c in name:
        k = k * 28 + (27 if c == 0x2A else c - 0x40)
    return k


class Line:
    """One command line: feed() while it arrives, then rewind() and next_command().

    After next_command() returned True: axis (-1 if none), name (see key(); 0 if too long to be
    known), kind (NOTHING, QUERY, PLUS, MINUS or NUMBER) and, for a number, negative, whole
    (at most 7 digits) and millionths. text[:address_length] is the address prefix, `>` included.
    """

    def __init__(self):
        self.text = bytearray(MAX_LINE)
        self.length = 0
        self.address_length = 0
        self._read = 0
        self._ended = False
        self._first = True
        self._clear()

    def start(self):
        """Forget what was there; the next byte is the first of a line."""
        self.length = 0
        self.rewind()

    def feed(self, c):
        """Take byte c. MORE, COMMAND, END, BAD or TOO_LONG."""
        if c != _CR and c != _LF:
            if self.length == MAX_LINE:
                return TOO_LONG
            self.text[self.length] = c
            self.length += 1
        return self._scan(c)

    def rewind(self):
        """Go back to before the first command."""
        self._read = 0
        self._ended = False
        self._first = True
        self.address_length = 0
        self._clear()

    def next_command(self):
        """Step to the next command of a line that feed() found good. False when there is none."""
        if self._read > self.length:
            return False
        while self._read < self.length:
            c = self.text[self._read]
            self._read += 1
            if self._scan(c) == COMMAND:
                return True
        self._read += 1
        self._scan(_LF)
        return True

    def rounded(self):
        """The number as the nearest integer, halves away from zero."""
        n = self.whole + (1 if self.millionths >= 500000 else 0)
        return -n if self.negative else n

    def hundredths(self):
        """The number in hundredths, halves away from zero."""
        n = self.whole * 100 + (self.millionths + 5000) // 10000
        return -n if self.negative else n

    def _clear(self):
        self.axis = -1
        self.name = 0
        self.kind = NOTHING
        self.negative = False
        self.whole = 0
        self.millionths = 0
        self._state = _START
        self._digits = 0
        self._number = 0

    def _scan(self, c):
        if c == 0x3B or c == _LF or c == _CR:
            return self._finish(c)
        if self._ended:  # the fields of the command before were still being read
            self._ended = False
            self._clear()
        state = self._state
        if state == _START or state == _AXIS or state == _AXIS_SPACE:
            return self._before_name(c)
        if state == _NAME and (0x41 <= c & 0xDF <= 0x5A):
            self._letter(c)
            return MORE
        return self._after_name(c)

    def _before_name(self, c):
        state = self._state
        if 0x30 <= c <= 0x39 and state != _AXIS_SPACE:
            if self._digits == 2:
                return BAD
            self._digits += 1
            self._number = self._number * 10 + c - 0x30
            self._state = _AXIS
        elif c == 0x3E and state == _AXIS and self._first:
            self.address_length = self._digits + 1
            self._first = False
            self._clear()
        elif c == 0x20:
            if state == _AXIS:
                self._state = _AXIS_SPACE
        elif 0x41 <= c & 0xDF <= 0x5A or c == 0x2A:
            if self._digits:
                self.axis = self._number
            self._digits = 0
            self._state = _NAME
            self._letter(c)
        else:
            return BAD
        return MORE

    def _letter(self, c):
        self._digits += 1  # counts letters here
        if self._digits > _MAX_NAME:
            self.name = 0
        else:
            self.name = self.name * 28 + (27 if c == 0x2A else (c & 0xDF) - 0x40)

    def _after_name(self, c):
        state = self._state
        if state == _NAME and self.name == 27:  # a `*` alone
            return BAD
        if 0x30 <= c <= 0x39:
            return self._digit(c - 0x30)
        if c == 0x20:
            if state == _NAME:
                self._state = _NAME_SPACE
            elif state != _NAME_SPACE:
                if state == _POINT:
                    return BAD
                self._state = _AFTER_VALUE
            return MORE
        if c == 0x2E and state == _WHOLE:
            self._state = _POINT
            self._digits = 0
            return MORE
        if state != _NAME and state != _NAME_SPACE:
            return BAD
        if c == 0x3F:
            self.kind = QUERY
            self._state = _AFTER_VALUE
        elif c == 0x2B or c == 0x2D:
            self.negative = c == 0x2D
            self.kind = MINUS if self.negative else PLUS
            self._state = _SIGN
        else:
            return BAD
        return MORE

    def _digit(self, d):
        state = self._state
        if state == _POINT or state == _DECIMALS:
            if self._digits == 6:
                return BAD
            self._digits += 1
            place = 1000000
            for _ in range(self._digits):
                place //= 10
            self.millionths += d * place
            self._state = _DECIMALS
            return MORE
        if state == _AFTER_VALUE:
            return BAD
        if state != _WHOLE:
            self._digits = 0
            self.kind = NUMBER
            self._state = _WHOLE
        if self._digits == 7:
            return BAD
        self._digits += 1
        self.whole = self.whole * 10 + d
        return MORE

    def _finish(self, c):
        state = self._state
        if self._ended or state < _NAME or state == _POINT or (state == _NAME and self.name == 27):
            return BAD  # nothing stands where a command must
        self._ended = True
        self._first = False
        return COMMAND if c == 0x3B else END
