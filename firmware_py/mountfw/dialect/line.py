"""The grammar of a command line. Pure.

    [address>] [axis] MNEMONIC [value] {; [axis] MNEMONIC [value]} (CR or LF)

It is the dialect of New Focus 8742/8743-CL controllers. A line is read twice. As the bytes arrive,
feed() takes each through the table of states below, and refuses a line at the first byte that cannot
continue it. When the line has ended, advance() goes through it again and picks out the fields,
command by command. Nothing is executed before the whole line was found good, and nothing is allocated.
"""

from mountfw import const

MORE = const(0)
COMMAND = const(1)  # the fields are those of the next command
END = const(2)  # the line has ended
BAD = const(-1)
TOO_LONG = const(-2)

MAX_LINE = const(128)

# what came after the mnemonic
NOTHING = const(0)
QUERY = const(1)
PLUS = const(2)
MINUS = const(3)
NUMBER = const(4)

_AT_ONCE = const(2)  # bytes that one call of advance() reads at most: a stop waits so long
_MAX_NAME = const(6)  # letters that fit an integer below 2**30 to the base 28
HUGE = const(9_999_999)  # stands for every larger number: beyond all ranges, and its hundredths stay below 2**30
_TENTH_OF_HUGE = const(1_000_000)
_FIRST_DECIMAL = const(100_000)  # what it counts, in millionths

# Each state, and what it becomes with which byte. Where a byte is not named, it cannot continue the line.
# 0 stands for a digit, 00 for a zero where that is another matter, A for a letter, + for a sign, $ for LF (CR counts
# as LF), a comma for other punctuation. A number has up to ten digits before its point, as a 32-bit controller takes
# them, but up to seven if it begins with 0: eight of them behind letters are a frame that came after garbage.
# Names of six letters and more (HOSTNAME, IPADDR ...) are a network's: what follows them is text, without a `#`.
#
# first    0 first1  A name  * star  space first
# first1   0 first2  A name  * star  space axis_  > start
# first2             A name  * star  space axis_  > start
# start    0 axis1   A name  * star  space start
# axis1    0 axis2   A name  * star  space axis_
# axis2              A name  * star  space axis_
# axis_              A name  * star  space axis_
# star               A name
# name     0 whole1  A name2         space name_  + sign  ? after  ; start  $ end  00 whole4
# name2    0 whole1  A name3         space name_  + sign  ? after  ; start  $ end  00 whole4
# name3    0 whole1  A name4         space name_  + sign  ? after  ; start  $ end  00 whole4
# name4    0 whole1  A name5         space name_  + sign  ? after  ; start  $ end  00 whole4
# name5    0 whole1  A long          space name_  + sign  ? after  ; start  $ end  00 whole4
# long     0 text    A long          space text   + text  ? after  ; start  $ end  . text   , text
# name_    0 whole1                  space name_  + sign  ? after  ; start  $ end  00 whole4
# sign     0 whole1                  space after                   ; start  $ end  00 whole4
# whole1   0 whole2  . point         space after                   ; start  $ end
# whole2   0 whole3  . point         space after                   ; start  $ end
# whole3   0 whole4  . point         space after                   ; start  $ end
# whole4   0 whole5  . point         space after                   ; start  $ end
# whole5   0 whole6  . point         space after                   ; start  $ end
# whole6   0 whole7  . point         space after                   ; start  $ end
# whole7   0 whole8  . point         space after                   ; start  $ end
# whole8   0 whole9  . point         space after                   ; start  $ end
# whole9   0 whole10 . point         space after                   ; start  $ end
# whole10            . point         space after                   ; start  $ end
# point    0 part
# part     0 part                    space after                   ; start  $ end
# after                              space after                   ; start  $ end
# text     0 text    A text          space text   + text  ? text   ; start  $ end  . text   , text  * text
# end

_CLASS = (  # the column of each byte below 0x80
    # classes: made by tools/tables.py
    b"\x0c\x0c\x0c\x0c\x0c\x0c\x0c\x0c\x0c\x0c\x06\x0c\x0c\x06\x0c\x0c\x0c\x0c\x0c\x0c\x0c\x0c\x0c\x0c\x0c\x0c\x0c\x0c"
    b"\x0c\x0c\x0c\x0c\x03\x0c\x0a\x0c\x0a\x0a\x0a\x0a\x0a\x0a\x02\x07\x0a\x07\x09\x0a\x0b\x00\x00\x00\x00\x00\x00\x00"
    b"\x00\x00\x0a\x05\x0a\x0a\x04\x08\x0a\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01"
    b"\x01\x01\x01\x01\x01\x01\x01\x0a\x0a\x0a\x0a\x0a\x0a\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01"
    b"\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x01\x0a\x0a\x0a\x0a\x0c"
    # end
)
_NEXT = (  # for each state: the number of the next one, by the byte's column
    # transitions: made by tools/tables.py
    b"\x01\x08\x07\x00\xff\xff\xff\xff\xff\xff\xff\x01\xff"  # first
    b"\x02\x08\x07\x06\x03\xff\xff\xff\xff\xff\xff\x02\xff"  # first1
    b"\xff\x08\x07\x06\x03\xff\xff\xff\xff\xff\xff\xff\xff"  # first2
    b"\x04\x08\x07\x03\xff\xff\xff\xff\xff\xff\xff\x04\xff"  # start
    b"\x05\x08\x07\x06\xff\xff\xff\xff\xff\xff\xff\x05\xff"  # axis1
    b"\xff\x08\x07\x06\xff\xff\xff\xff\xff\xff\xff\xff\xff"  # axis2
    b"\xff\x08\x07\x06\xff\xff\xff\xff\xff\xff\xff\xff\xff"  # axis_
    b"\xff\x08\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff"  # star
    b"\x10\x09\xff\x0e\xff\x03\x1e\x0f\x1c\xff\xff\x13\xff"  # name
    b"\x10\x0a\xff\x0e\xff\x03\x1e\x0f\x1c\xff\xff\x13\xff"  # name2
    b"\x10\x0b\xff\x0e\xff\x03\x1e\x0f\x1c\xff\xff\x13\xff"  # name3
    b"\x10\x0c\xff\x0e\xff\x03\x1e\x0f\x1c\xff\xff\x13\xff"  # name4
    b"\x10\x0d\xff\x0e\xff\x03\x1e\x0f\x1c\xff\xff\x13\xff"  # name5
    b"\x1d\x0d\xff\x1d\xff\x03\x1e\x1d\x1c\x1d\x1d\x1d\xff"  # long
    b"\x10\xff\xff\x0e\xff\x03\x1e\x0f\x1c\xff\xff\x13\xff"  # name_
    b"\x10\xff\xff\x1c\xff\x03\x1e\xff\xff\xff\xff\x13\xff"  # sign
    b"\x11\xff\xff\x1c\xff\x03\x1e\xff\xff\x1a\xff\x11\xff"  # whole1
    b"\x12\xff\xff\x1c\xff\x03\x1e\xff\xff\x1a\xff\x12\xff"  # whole2
    b"\x13\xff\xff\x1c\xff\x03\x1e\xff\xff\x1a\xff\x13\xff"  # whole3
    b"\x14\xff\xff\x1c\xff\x03\x1e\xff\xff\x1a\xff\x14\xff"  # whole4
    b"\x15\xff\xff\x1c\xff\x03\x1e\xff\xff\x1a\xff\x15\xff"  # whole5
    b"\x16\xff\xff\x1c\xff\x03\x1e\xff\xff\x1a\xff\x16\xff"  # whole6
    b"\x17\xff\xff\x1c\xff\x03\x1e\xff\xff\x1a\xff\x17\xff"  # whole7
    b"\x18\xff\xff\x1c\xff\x03\x1e\xff\xff\x1a\xff\x18\xff"  # whole8
    b"\x19\xff\xff\x1c\xff\x03\x1e\xff\xff\x1a\xff\x19\xff"  # whole9
    b"\xff\xff\xff\x1c\xff\x03\x1e\xff\xff\x1a\xff\xff\xff"  # whole10
    b"\x1b\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\x1b\xff"  # point
    b"\x1b\xff\xff\x1c\xff\x03\x1e\xff\xff\xff\xff\x1b\xff"  # part
    b"\xff\xff\xff\x1c\xff\x03\x1e\xff\xff\xff\xff\xff\xff"  # after
    b"\x1d\x1d\x1d\x1d\xff\x03\x1e\x1d\x1d\x1d\x1d\x1d\xff"  # text
    b"\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff"  # end
    # end
)
_COLUMNS = const(13)
_END = len(_NEXT) // _COLUMNS - 1
_NOT_ALLOWED = const(255)


def key(name):
    """The integer that stands for a mnemonic (bytes, `*` allowed first), told by its first 6 letters."""
    if len(name) == 2 and name[0] != 0x2A:  # most are: 80 of them, and a start takes 5 ms less
        return (name[0] - 0x40) * 28 + name[1] - 0x40
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
        """Read on in a line that feed() found good, while there is more(). COMMAND: one is complete; else MORE."""
        if self._complete:
            self._complete = False
            self._clear()
        for _ in range(_AT_ONCE):
            i = self._read
            if i > self.length:
                break
            self._read = i + 1
            if i == self.length or self.text[i] == 0x3B:
                self._complete = True
                return COMMAND
            self._field(self.text[i])
        return MORE

    def more(self):
        """False as soon as advance() has read the whole line."""
        return self._read <= self.length

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
