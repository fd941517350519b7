"""The wire's rules, a second time and in another way: by patterns over the text so far.

parse() takes what a session sends as (byte, silence before it in microseconds) and returns what
the board must understand: a list of events. Written from docs/protocol.md, not from the firmware.
"""

import re

FRAME = re.compile(r"[0+-]\d{3}[0+-]\d{3}")
NUMBER = r"[+-]?(0\d{0,6}|[1-9]\d{0,9})(\.\d+)?"
SHORT = rf"\*?[A-Za-z]+ *(\?|[+-]|{NUMBER})? *"
LONG = r"\*?[A-Za-z]{6,}(\? *|[ \"$-)+-:<=@[-`{-~][ \"$-:<=?-~]*)?"  # a network's name, and text
COMMAND = rf" *(\d{{1,2}} *)?({SHORT}|{LONG})"
LINE = re.compile(rf"(\d{{1,2}}>)?{COMMAND}(;{COMMAND})*")

IGNORED = {1, 2, 4, 5, 0x18}
BLANK = {0, 10, 13, 32}
FRAME_GAP_US = 50_000
LINE_GAP_US = 1_000_000


def frame_may_begin_with(text: str) -> bool:
    """Could `text` be the beginning of a frame (or, while it is `0` or `0d`, of an address)?"""
    if len(text) == 2 and re.fullmatch(r"0\d", text):
        return True
    for field in (text[:4], text[4:]):
        digits = field[1:]
        if field and (field[0] not in "0+-" or (digits and not digits.isdecimal())):
            return False
        # a field's hundreds digit is judged together with the digit after it
        if len(digits) >= 2 and int(digits.ljust(3, "0")) > 255:
            return False
    return True


def line_may_begin_with(text: str) -> bool:
    """Could `text` be the beginning of a line?"""
    return any(LINE.fullmatch(text + rest) for rest in ("", "A", "0"))


def parse(session: list[tuple[int, int]]) -> list[tuple]:
    """What the board must understand of a session."""
    events: list[tuple] = []
    text, mode, zeros = "", "", 0  # mode: "" at a boundary, "frame", "line", "skip" to a line end, "drop" to a gap

    def refuse(why: str, c: int) -> tuple[str, str]:
        events.append(("returned" if c == 0x23 else why,))
        return "", "drop" if c == 0x23 else "" if c in (10, 13) else "skip"

    for c, silence_us in session:
        if mode and silence_us >= (LINE_GAP_US if mode == "line" else FRAME_GAP_US):
            if mode not in ("skip", "drop"):
                events.append(("bad",))
            text, mode = "", ""
        zeros = zeros + 1 if c == 0x30 else 0
        eight, zeros = zeros == 8, zeros % 8
        if c in (0x21, 3):
            events.append(("stop",))
            text, mode = "", mode if mode == "drop" else "skip" if mode else ""
        elif c in IGNORED:
            pass
        elif mode in ("skip", "drop"):
            if eight:
                events.append(("zeros",))
            if c == 0x23:
                mode = "drop"
            elif c in (10, 13) and mode == "skip":
                mode = ""
        elif not mode and c in BLANK:
            pass
        else:
            if not mode:
                first = chr(c) if c < 0x80 else ""
                mode = "frame" if first and first in "0+-" else "line" if re.match(r"[A-Za-z1-9*]", first) else ""
                if not mode:
                    text, mode = refuse("bad", c)
                    continue
            if mode == "frame" and c == 0x3E and re.fullmatch(r"0\d?", text):
                mode = "line"
            ended = c in (10, 13)
            seen = text + chr(c)
            if mode == "frame":
                if ended or not frame_may_begin_with(seen):
                    text, mode = refuse("bad", c)
                elif FRAME.fullmatch(seen):
                    events.append(("frame", int(seen[:4]), int(seen[4:])))
                    text, mode = "", ""
                else:
                    text = seen
                    if eight:
                        events.append(("zeros",))
            elif ended:
                if LINE.fullmatch(text):
                    events.append(("line", text))
                    text, mode = "", ""
                else:
                    text, mode = refuse("bad", c)
            elif eight:
                text, mode = refuse("bad", c)
            elif len(text) == 128:
                text, mode = refuse("long", c)
            elif not line_may_begin_with(seen):
                text, mode = refuse("bad", c)
            else:
                text = seen
    return events
