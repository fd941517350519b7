"""Relays between a network client and a board: limits the bytes on their way, feeds the keep-alive.

- A stop overtakes waiting bytes; at most AHEAD bytes are before it on their way to the board.
- While a motion of the client lasts, this program feeds the board's keep-alive: the motion ends within 0.5 s if this
  program dies or hangs.
- A client's own keep-alive (XK) stays the client's: it fires as on the board's own port.

Progress and motion of the board are asked for under an address that clients do not use; those replies are removed.
"""

import math
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from mirrormount.common.errors import NotAMount
from mirrormount.common.keep_alive import KEEP_ALIVE_MS
from mirrormount.device.status import parse_status
from mirrormount.network.messages import FRAME, LINE, Messages

AHEAD = 512  # bytes sent to the board and not yet executed
_ASK_AFTER = 128  # bytes; then a query shows when the board has executed them
_ADDRESS = b"01>"  # the board's own address, written as nobody else does
_FEED_S = 0.1
_ANSWER_S = 0.5  # a later reply was dropped by the board
_HOLD_LINE_S, _HOLD_FRAME_S = 0.5, 0.05  # then an unfinished message goes to the board as it is
_MARGIN_S, _LAPSE_S = 0.3, 0.05  # added to the board's gap, and to the client's keep-alive, before they count as over
_DAMAGE = 0x7F  # malformed wherever it stands: the board stops, and skips up to a line end or a silence
_SKIP_S = 0.02  # in which a board skips AHEAD bytes
_DECIDE_S = 0.03  # in which the bytes behind a frame show the board if it is its own reply: nothing of ours between


class _Question(NamedTuple):
    ours: bool
    size: int = 0  # bytes executed by the board when it replies
    motions: int = 0  # that were started before it was asked
    at_s: float = 0.0
    unmutes: bool = False


class Relay:
    """write hands bytes to the board. Call pump() when there may be something to do: at least every due_s()."""

    def __init__(self, write: Callable[[bytes], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._write = write
        self._clock = clock
        self._waiting = bytearray()
        self._urgent = 0  # bytes of it, up to a stop, that do not wait for the board
        self._messages = Messages()
        self._held = bytearray()  # of a message that is not complete
        self._raw = False  # the board is in the middle of a message, or skips the rest of one
        self._received_s = self._written_s = self._fed_s = clock()
        self._asked: deque[_Question] = deque()  # answers with our address that will come
        self._ahead = self._unasked = 0
        self._line = b""
        self._mute = False
        self.client_ms = 0  # the keep-alive that the client has set
        self._kept_s, self._frame_s = 0.0, -math.inf  # when the board's was last set; when a frame that drives was sent
        self._motions = 0
        self._axes: dict[int, str] = {}  # what was started there: "move" is of known length, "run" is not
        self.moving = False  # as far as is known

    # ---- from the client

    def from_client(self, data: bytes) -> None:
        """Queue bytes for the board. A stop overtakes, and drops the bytes that waited before it."""
        now_s = self._clock()
        if now_s - self._received_s > self.client_ms * 1e-3:
            self.client_ms = 0  # it has fired or lapsed
        self._received_s = now_s
        waited = len(self._waiting)
        self._waiting += data
        zeros = self._waiting.rfind(b"00000000", max(0, waited - 7))
        stop = max(self._waiting.rfind(b"!", waited), zeros)
        if stop > AHEAD:
            self.discard_partial()
            self._waiting[:stop] = b"!\n"  # the board may be in the middle of a message: this ends it
            stop = 2
        if stop >= 0:
            self._urgent = max(self._urgent, stop + 8)
        self.pump()
        if 0 < self.client_ms <= KEEP_ALIVE_MS and data and not self._raw and now_s - self._frame_s > _DECIDE_S:
            self._write(b"\0")  # what is held here must not look like silence to the board

    @property
    def waiting(self) -> int:
        """Bytes in the queue."""
        return len(self._waiting)

    def discard_partial(self) -> None:
        """Drop an unfinished message: a stop is sent to the board."""
        self._held.clear()
        self._messages = Messages()
        self._raw = False

    def stop(self) -> None:
        """Stop the motors and drop the queue."""
        self._waiting.clear()
        self._urgent = 0
        self.discard_partial()
        self._send(b"!\n")
        self._axes.clear()
        self.client_ms = 0

    def client_left(self) -> bool:
        """The client is gone: moves of known length go on, all else ends. True if a move goes on."""
        if len(self._waiting) > AHEAD:
            self.stop()
            return False
        self._urgent = len(self._waiting)
        self.pump()
        if self._raw or "move" not in self._axes.values():  # the board refuses half a message, and stops; so does this
            self.stop()
            return False
        self.discard_partial()
        runs = b"".join(b"%dST\n" % axis for axis, kind in self._axes.items() if kind == "run")
        self.client_ms = 0
        self._send(runs + b"XK%d\n" % KEEP_ALIVE_MS)
        return True

    def query_motion(self) -> None:
        """Query the board's motion at the next pump(), whatever is known of it."""
        self._motions += 1
        self.moving = True

    def mute_old_replies(self) -> None:
        """Drop replies to earlier clients, up to the reply to a query that is sent now."""
        self._mute = True
        self._ask(b"XK?", unmutes=True)

    # ---- to the board

    def pump(self) -> None:
        """Send queued bytes up to AHEAD, and feed the keep-alive. Raises ConnectionLost."""
        now_s = self._clock()
        if self._asked and now_s - self._asked[0].at_s > _ANSWER_S:
            self._asked.clear()
            self._ahead = self._unasked = 0
            self._mute = False
        if self._raw and now_s - self._written_s > _SKIP_S:
            self._ahead = self._unasked = 0  # what is skipped answers nothing
        if self._raw and self._waiting:
            self._resynchronise(now_s)
        out = bytearray()
        while self._waiting and (self._urgent > 0 or self._ahead + len(out) < AHEAD):
            c = self._waiting[0]
            del self._waiting[0]
            self._urgent -= 1
            self._held.append(c)
            message = self._messages.feed(c)
            if message or self._raw or not self._messages.gap_s:
                out += self._complete(message)
        self._send(out)
        self._urgent = max(0, self._urgent)
        self._give_up(now_s)
        if not self._raw:
            if self._unasked >= _ASK_AFTER:
                self._ask(b"XK?")
            if now_s - self._frame_s > _DECIDE_S:
                self._feed(now_s)

    def due_s(self) -> float:
        """Seconds until pump() must be called, with or without events."""
        if self._held or self._raw:
            return 0.02
        if self.moving or self._asked:
            return 0.05 if not self.client_ms else 0.01
        return 0.5

    def _complete(self, message: int) -> bytes:
        """The held bytes, with the keep-alive for the motion that they start. A frame's is before it: see _DECIDE_S."""
        data, self._held = bytes(self._held), bytearray()
        self._raw = bool(self._messages.gap_s)
        before = after = b""
        if message == FRAME and self._messages.frame_drives():
            self._axes |= {1: "run", 2: "run"}  # a move of a third axis goes on
            self._motions += 1
            self.moving = True
            self._frame_s = self._clock()
            if self._frame_s - self._kept_s > _FEED_S:
                before = self._keep_alive()
        elif message == LINE:
            before, after = self._line_complete()
        return before + data + after

    def _line_complete(self) -> tuple[bytes, bytes]:
        before = b""
        touched = query = False
        for command in self._messages.commands():
            query = query or command.is_query
            if command.is_a(b"XK", b"*RST"):
                if command.is_query:
                    before = b"XK%d\n" % self.client_ms
                elif command.is_a(b"*RST"):
                    self.client_ms = 0
                elif 0 <= command.value <= 60_000:
                    self.client_ms = command.value
                touched = True
            elif not command.is_query and command.is_a(b"PR", b"PA", b"XU", b"OR", b"MT", b"MV"):
                kind = "run" if command.is_a(b"MV") or self._axes.get(command.axis) == "run" else "move"
                self._axes[command.axis] = kind  # a move that is refused because of a run does not end the run
                self._motions += 1
                self.moving = touched = True
        if query and self._messages.address() == _ADDRESS:
            self._asked.append(_Question(False, at_s=self._clock()))
        return before, self._keep_alive() if touched else b""

    def _keep_alive(self) -> bytes:
        ms = min(self.client_ms, KEEP_ALIVE_MS) or KEEP_ALIVE_MS
        # a shorter one may be over by the next frame, and the board then has none
        self._kept_s = self._clock() if ms == KEEP_ALIVE_MS else -math.inf
        return b"XK%d\n" % ms

    def _resynchronise(self, now_s: float) -> None:
        """After a silence in a message, make sure that the board and this parser are at the same place of the stream.

        The board counts its own silence. Without this a motion could start there that is none here.
        """
        silence_s, gap_s = now_s - self._written_s, self._messages.gap_s
        if silence_s > gap_s:
            self.discard_partial()
            self._send(b"!\n")  # the board has given the message up, and has stopped
        elif silence_s > gap_s / 2:
            self._messages.feed(_DAMAGE)
            self._send(bytes((_DAMAGE,)))

    def _give_up(self, now_s: float) -> None:
        """Send a message that the client does not finish to the board, which refuses it."""
        gap_s = self._messages.gap_s
        hold_s = _HOLD_LINE_S if gap_s > 0.1 else _HOLD_FRAME_S
        if self._held and not self._waiting and now_s - self._received_s > hold_s:
            self._send(bytes(self._held))
            self._held.clear()
            self._raw = True
        elif self._raw and now_s - self._written_s > gap_s + _MARGIN_S:
            self._messages.gap()
            self._raw = False

    def _feed(self, now_s: float) -> None:
        """Query the motion while there may be one; the query also feeds the keep-alive."""
        if self.client_ms:
            silence_s = now_s - self._received_s
            if silence_s > self.client_ms * 1e-3 + _LAPSE_S:
                self.client_ms = 0  # it has fired or lapsed: it is fed no more for this motion
                self.moving = False
                return
            last_s = self._received_s + (self.client_ms - KEEP_ALIVE_MS) * 1e-3
            if now_s >= last_s:  # once more, and the board's keep-alive ends when the client's does
                if self.moving and self._fed_s < last_s:
                    self._fed_s = now_s
                    self._ask(b"XS?")
                return
        if self.moving and now_s - self._fed_s >= _FEED_S:
            self._fed_s = now_s
            self._ask(b"XS?")

    def _ask(self, query: bytes, *, unmutes: bool = False) -> None:
        line = _ADDRESS + query + b"\n"
        size = self._unasked + len(line)
        self._asked.append(_Question(True, size, self._motions, self._clock(), unmutes))
        self._send(line)
        self._unasked = 0

    def _send(self, data: bytes | bytearray) -> None:
        if data:
            self._ahead += len(data)
            self._unasked += len(data)
            self._written_s = self._clock()
            self._write(bytes(data))

    # ---- from the board

    def from_board(self, data: bytes) -> bytes:
        """The client's part of the board's replies: whole lines."""
        whole, end, self._line = (self._line + data).rpartition(b"\n")
        return b"".join([line for line in (whole + end).splitlines(keepends=True) if self._is_the_clients(line)])

    def _is_the_clients(self, line: bytes) -> bool:
        if not line.startswith(_ADDRESS):
            return not self._mute
        question = self._asked.popleft() if self._asked else _Question(True)
        if not question.ours:
            return not self._mute
        self._ahead = max(0, self._ahead - question.size)
        if b"|" in line:
            self._see_status(line.decode("ascii", "replace").removeprefix(_ADDRESS.decode()).strip(), question)
        if question.unmutes:
            self._mute = False
        return False

    def _see_status(self, status: str, question: _Question) -> None:
        try:
            seen = parse_status(status, 1)
        except NotAMount:  # damaged on its way: the next one is not
            return
        if question.motions == self._motions:
            moving = {number for number, axis in enumerate(seen.axes, 1) if axis.moving}
            self._axes = {axis: kind for axis, kind in self._axes.items() if axis in moving}
            self.moving = seen.moving
