"""The echo of a frame: five lines, as the paper's sketch answers it. Pure; imports nothing."""

# pyright: reportAttributeAccessIssue=false
# (what Echo uses, Replies has)
from mountfw import const

_ZERO = const(0x30)
_SIGNS = b"0+-"  # by two bits of a packed frame (wire/frame.py)
_POWERS = (0, 100, 10, 1)  # of the digits of a field
_CR_AT = const(8)  # where in a line its end stands


class Echo:
    """A part of Replies. An echo stands in their queue as None and the packed frame."""

    def echo(self, packed):
        """Queue the echo of a packed frame, as the paper's sketch sends it: a whole reply. False if it did not fit."""
        self.begin()
        self.field(None, packed)  # no text: it is a frame
        return self.commit()

    def _echoed(self, packed):
        """Five lines: 0 the frame, 1 and 2 its numbers, 3 and 4 their magnitudes. _at is 16 x line + place."""
        line = self._at >> 4
        place = self._at & 0xF
        if self._at == 0:
            self._own.sent_frame(packed)
        self._at += 1
        if place == _CR_AT:
            return 13
        if place > _CR_AT:
            self._at = line + 1 << 4
            if line == 4:
                self._at = 0
                self._drop_item()
                self._drop_item()
            return 10
        if line == 0:
            field = packed >> 10 if place < 4 else packed
            place &= 3
            return _SIGNS[field >> 8 & 3] if place == 0 else _ZERO + (field & 0xFF) // _POWERS[place] % 10
        field = packed >> 10 if line & 1 else packed
        n = field & 0xFF
        c = self._digit(-n if line < 3 and field & 0x200 else n)
        if not self._power:
            self._at = line << 4 | _CR_AT
        return c
