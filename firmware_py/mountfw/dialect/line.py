"""The grammar of a command line. Pure.

    [address>] [axis] MNEMONIC [value] {; [axis] MNEMONIC [value]} (CR or LF)

It is the dialect of New Focus 8742/8743-CL controllers. A line is read twice. As the bytes arrive,
feed() takes each through the table of states below, and refuses a line at the first byte that cannot
continue it. When the line has ended, advance() goes through it again and picks out the fields,
command by command. Nothing is executed before the whole line was found good, and nothing is allocated.
"""

MORE = 0
COMMAND = 1  # the fields are those of the next command
END = 2  # the line has ended
BAD = -1
TOO_LONG = -2

MAX_LINE = 128

# what came after the mnemonic
NOTHING = 0
QUERY = 1
PLUS = 2
MINUS = 3
NUMBER = 4

_CR = 13
_AT_ONCE = 4  # bytes that one call of advance() reads at most: a piece of work must be short
_MAX_NAME = 6  # letters that fit an integer below 2**30 to the base 28
HUGE = 9_999_999  # stands for every larger number: beyond all ranges, and its hundredths stay below 2**30
_TENTH_OF_HUGE = 1_000_000
_FIRST_DECIMAL = 100_000  # what it counts, in millionths

# Each state, and what it becomes with which byte. Where a byte is not named, it cannot continue the line.
# 0 stands for a digit, 00 for a zero where that is another matter, A for a letter, + for a sign, $ for LF (CR counts
# as LF), a comma for other punctuation. A number has up to ten digits before its point, as a 32-bit controller takes
# them, but up to seven if it begins with 0: eight of them behind letters are a frame that came after garbage.
# Names of six letters and more (HOSTNAME, IPADDR ...) are a network's: what follows them is text.
_GRAMMAR = """
first    0 first1  A name  * star  space first
first1   0 first2  A name  * star  space axis_  > start
first2             A name  * star  space axis_  > start
start    0 axis1   A name  * star  space start
axis1    0 axis2   A name  * star  space axis_
axis2              A name  * star  space axis_
axis_              A name  * star  space axis_
star               A name
name     0 whole1  A name2         space name_  + sign  ? after  ; start  $ end  00 whole4
name2    0 whole1  A name3         space name_  + sign  ? after  ; start  $ end  00 whole4
name3    0 whole1  A name4         space name_  + sign  ? after  ; start  $ end  00 whole4
name4    0 whole1  A name5         space name_  + sign  ? after  ; start  $ end  00 whole4
name5    0 whole1  A long          space name_  + sign  ? after  ; start  $ end  00 whole4
long     0 text    A long          space text   + text  ? after  ; start  $ end  . text   , text
name_    0 whole1                  space name_  + sign  ? after  ; start  $ end  00 whole4
sign     0 whole1                  space after                   ; start  $ end  00 whole4
whole1   0 whole2  . point         space after                   ; start  $ end
whole2   0 whole3  . point         space after                   ; start  $ end
whole3   0 whole4  . point         space after                   ; start  $ end
whole4   0 whole5  . point         space after                   ; start  $ end
whole5   0 whole6  . point         space after                   ; start  $ end
whole6   0 whole7  . point         space after                   ; start  $ end
whole7   0 whole8  . point         space after                   ; start  $ end
whole8   0 whole9  . point         space after                   ; start  $ end
whole9   0 whole10 . point         space after                   ; start  $ end
whole10            . point         space after                   ; start  $ end
point    0 part
part     0 part                    space after                   ; start  $ end
after                              space after                   ; start  $ end
text     0 text    A text          space text   + text  ? text   ; start  $ end  . text   , text  * text
end
"""
_CLASSES = "0A* >;\n+?.,"  # the kinds of bytes, of which the first is a digit from 1 to 9
_ZERO = 11
_OTHER = 12
_COLUMNS = 13
_NOT_ALLOWED = 255


def _class_of(c):
    if 0x30 <= c <= 0x39:
        return 0 if c > 0x30 else _ZERO
    if 0x41 <= c & 0xDF <= 0x5A:
        return 1
    kind = {_CR: "\n", 0x2D: "+"}.get(c, chr(c))
    if kind in _CLASSES:
        return _CLASSES.find(kind)
    return _CLASSES.find(",") if 0x22 <= c < 0x7F else _OTHER


def _table():
    """The grammar as bytes: _COLUMNS for each state, the number of the next state or _NOT_ALLOWED."""
    rows = [row.split() for row in _GRAMMAR.strip().split("\n")]
    number = {row[0]: i for i, row in enumerate(rows)}
    table = bytearray([_NOT_ALLOWED] * (_COLUMNS * len(rows)))
    for row in rows:
        for i in range(1, len(row), 2):
            at = _COLUMNS * number[row[0]]
            if row[i] in ("0", "00"):
                table[at + _ZERO] = number[row[i + 1]]
            if row[i] != "00":
                table[at + _CLASSES.find({"space": " ", "$": "\n"}.get(row[i], row[i]))] = number[row[i + 1]]
    return bytes(table), number["end"]


_CLASS = bytes([_class_of(c) for c in range(0x80)])
_NEXT, _END = _table()


def key(name):
    """The integer that stands for a mnemonic (bytes, `*` allowed first), told by its first 6 letters."""
    k = 0
    for c in name[:_MAX_NAME]:
        k = k * 28 + (27 if c == 0x2A else c - 0x40)
    return k


class Line:
    """One command line: feed() while it arrives, then rewind() and advance().

    After advance() returned COMMAND: axis (-1 if none), name (see key()), kind (NOTHING, QUERY, PLUS, MINUS
    or NUMBER) and, for a number, negative, whole (at most HUGE, which stands for what is larger) and millionths
    (not 0 if any decimal is not). text[:address_length] is the address prefix, `>` included.
    """

    def __init__(self):
        self.text = bytearray(MAX_LINE)
        self.start()
        self.rewind()

    def start(self):
        """Forget what was there; the next byte is the first of a line."""
        self.length = 0
        self.address_length = 0
        self._state = 0

    def feed(self, c):
        """Take byte c (below 0x80). MORE, END, BAD or TOO_LONG."""
        state = _NEXT[self._state * _COLUMNS + _CLASS[c]]
        if state == _END:
            return END
        length = self.length
        if length == MAX_LINE:
            return TOO_LONG
        if state == _NOT_ALLOWED:
            return BAD
        self._state = state
        self.text[length] = c
        self.length = length + 1
        if c == 0x3E:
            self.address_length = self.length
        return MORE

    def rewind(self):
        """Go back to before the first command."""
        self._read = self.address_length
        self._clear()
        self._complete = False

    def advance(self):
        """Read on in a line that feed() found good: MORE, COMMAND, or END when there are no more."""
        if self._complete:
            self._complete = False
            self._clear()
        for _ in range(_AT_ONCE):
            i = self._read
            if i > self.length:
                return END
            self._read = i + 1
            if i == self.length or self.text[i] == 0x3B:
                self._complete = True
                return COMMAND
            self._field(self.text[i])
        return MORE

    def address(self):
        """The number of the address prefix; -1 if there is none."""
        if not self.address_length:
            return -1
        n = self.text[0] - 0x30
        return n if self.address_length == 2 else n * 10 + self.text[1] - 0x30

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
        self._letters = 0
        self._point = False  # was there a decimal point?
        self._place = _FIRST_DECIMAL  # what the next digit after it counts, in millionths

    def _field(self, c):
        if self._letters == _MAX_NAME and c != 0x3F:
            return  # more of a long name, or the text after it
        if 0x30 <= c <= 0x39:
            d = c - 0x30
            if not self._letters:
                self.axis = d if self.axis < 0 else self.axis * 10 + d
            elif not self._point:
                self.kind = NUMBER
                whole = self.whole
                self.whole = whole * 10 + d if whole < _TENTH_OF_HUGE else HUGE
            elif self._place:
                self.millionths += d * self._place
                self._place //= 10
            elif d:
                self.millionths |= 1  # beyond the sixth decimal: not a whole number, and rounded as if it were cut off
        elif c >= 0x41 or c == 0x2A:
            self._letters += 1
            self.name = self.name * 28 + (27 if c == 0x2A else (c & 0xDF) - 0x40)
        elif c == 0x2E:
            self._point = True
        elif c == 0x3F:
            self.kind = QUERY
        elif c != 0x20:
            self.negative = c == 0x2D
            self.kind = MINUS if self.negative else PLUS
