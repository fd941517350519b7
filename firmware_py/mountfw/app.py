"""The loop: hear, obey, move on, answer. Joins the pure parts with a port, the hardware's verbs.

A port has ticks_us(), ticks_ms(), any(wait_ms), read(), writable(), write(c), led(on) and
undisturbed(action, argument). The loop sleeps only in any(), which says whether a byte waits and
returns as soon as one does.
"""

from mountfw import errors
from mountfw import link as wire
from mountfw.axis import NEVER_US, Axis
from mountfw.bridge import EnableBridge, TwoPwmBridge
from mountfw.command import Line
from mountfw.controller import Controller
from mountfw.endstop import EndStop
from mountfw.frame import Frame
from mountfw.ticks import add, diff

_SPIN_US = 250  # this long before a deadline the loop only watches the clock and listens
_RUN_SLEEP_MS = 20  # a run is counted at least this often, so that its sums stay small
_SLEEP_MS = 64  # the longest sleep: half a slot of the LED's patterns

built = None  # the App that was built last: what repl.py goes on with


class App:
    """The firmware of one mount. step() is one pass of the loop and never waits longer than _SLEEP_MS."""

    def __init__(self, port, controller, link, frame, line, replies):
        self.controller = controller
        self._port = port
        self._link = link
        self._frame = frame
        self._line = line
        self._replies = replies
        self._ticks_us = port.ticks_us
        self._any = port.any
        self._heard_at = 0
        self._woke_at = 0
        self._sleep_ms = 0
        self._due = False  # does a deadline of a move lie ahead?
        self._due_at = 0
        self._lit = False

    def run(self):
        """The loop, for ever. An internal fault stops the motors, is queued, and the loop goes on."""
        try:
            while True:
                try:
                    while True:
                        self.step()
                except Exception:
                    self.controller.shutdown(errors.FAULT)
                    self.controller.errors.push(errors.INTERNAL_FAULT)
        finally:  # Ctrl-C: every move ends here and now, so that it is counted right
            self._port.undisturbed(self.controller.shutdown, errors.ABORTED)

    def step(self):
        """One pass: hear, obey one message, move on, answer."""
        heard = self._hear(self._sleep_ms)
        self._obey(self._link.next())
        now_us = self._ticks_us()
        quiet_us = NEVER_US if heard or self._link.unparsed else self._silence(now_us)
        left_us = self.controller.service(now_us)
        if left_us < _SPIN_US:
            self._spin(add(now_us, left_us if left_us > 0 else 0))
            left_us = 0
        else:
            self._answer()
        self._due = left_us < NEVER_US
        if self._due:
            self._due_at = add(now_us, left_us)
        self.show()
        # after a byte the next pass looks at once, so that a pause is seen from its beginning
        self._sleep_ms = 0 if heard else self._how_long(left_us if left_us < quiet_us else quiet_us)
        self.controller.passed(diff(self._ticks_us(), self._woke_at))

    def _hear(self, wait_ms):
        """Take in all that waits, stops first. True if there was anything."""
        waits = self._any(wait_ms)
        self._woke_at = self._ticks_us()
        if not waits:
            return False
        watching = self.controller.watching()
        while self._link.room():
            self._take()
            if watching or (self._due and diff(self._due_at, self._ticks_us()) <= 0):
                self.controller.service(self._ticks_us())  # a burst must not hold up what is due
                self._due = False
            if not self._any(0):
                break
        self._note_heard()
        return True

    def _note_heard(self):
        self._heard_at = self._ticks_us()
        self.controller.heard(self._heard_at)

    def _take(self):
        """Take in one byte. If it completes a stop, off comes before anything else."""
        stop = self._link.receive(self._port.read())
        if stop:
            self.controller.stop_all(errors.ABORTED if stop == wire.STOP else errors.STOPPED)
            self.controller.hold(True)

    def _obey(self, message):
        controller = self.controller
        if message == wire.STOP:
            controller.stop_all(errors.ABORTED)
        elif message == wire.ZEROS:
            controller.stop_all(errors.STOPPED)
        elif message == wire.FRAME:
            controller.frame(self._frame)
        elif message == wire.LINE:
            controller.line(self._line)
        elif message == wire.MALFORMED:
            controller.malformed(errors.MALFORMED)
        elif message == wire.TOO_LONG:
            controller.malformed(errors.LINE_TOO_LONG)
        if message and not self._link.stops_ahead:
            controller.hold(False)

    def _silence(self, now_us):
        """Nothing waits. Give up what stays unfinished; returns the time to the next such deadline."""
        left_us = self.controller.silence(now_us)
        gap_us = self._link.gap_us()
        if gap_us:
            gap_us -= diff(now_us, self._heard_at)
            if gap_us <= 0:
                self._obey(self._link.gap())
            elif gap_us < left_us:
                left_us = gap_us
        return left_us

    def _spin(self, until_us):
        """The last stretch of a pulse: the clock, and bytes that may be a stop; all else waits."""
        while diff(until_us, self._ticks_us()) > 0:
            if self._link.room() and self._any(0):
                self._take()
                self._note_heard()
        self.controller.service(self._ticks_us())

    def _answer(self):
        """Send one byte, if the host takes it. Nothing ever waits for output."""
        if self._replies.waiting() and self._port.writable():
            self._port.write(self._replies.read())

    def show(self):
        """The LED: on = ready, blinking = driving, double blink = an error waits to be read."""
        slot = self._port.ticks_ms() >> 7 & 7
        if self.controller.driving():
            lit = slot & 1 == 0
        elif self.controller.errors.waiting:
            lit = slot == 0 or slot == 2
        else:
            lit = True
        if lit != self._lit:
            self._lit = lit
            self._port.led(lit)

    def _how_long(self, left_us):
        """Milliseconds that the next pass may sleep."""
        if self._link.unparsed or self.controller.watching():
            return 0
        ms = (left_us - _SPIN_US) // 1000 if left_us > _SPIN_US else 0
        if self._replies.waiting():
            most = 0 if self._port.writable() else 1
        else:
            most = _RUN_SLEEP_MS if self.controller.driving() else _SLEEP_MS
        return ms if ms < most else most


def build(port, board):
    """An App on a port (see port_micropython.py), wired as a board file says (see boards/)."""
    global built
    error_queue = errors.ErrorQueue()
    replies = wire.Replies()
    frame = Frame()
    line = Line()
    axes = []
    for number, pins in ((1, board.AXIS_1), (2, board.AXIS_2)):
        if board.BRIDGE == "enable":
            bridge = EnableBridge(
                port.Output(pins["en"], board.PWM_HZ),
                port.Output(pins["pos"]),
                port.Output(pins["neg"]),
                board.DEAD_TIME_US,
                port.pause_us,
            )
        else:
            bridge = TwoPwmBridge(
                port.Output(pins["pos"], board.PWM_HZ),
                port.Output(pins["neg"], board.PWM_HZ),
                board.DEAD_TIME_US,
                port.pause_us,
            )
        stops = [EndStop(port.reader(pins[name])) for name in ("stop_pos", "stop_neg")]
        axes.append(Axis(number, bridge, stops[0], stops[1], error_queue, port.ticks_us))
    controller = Controller(
        axes[0],
        axes[1],
        replies,
        error_queue,
        board.NAME,
        port.unique_id(),
        port.boot_id(),
        port.ticks_ms,
        port.firmware_hash(),
        port.reset_cause(),
        port.free_memory,
    )
    built = App(port, controller, wire.Link(frame, line), frame, line, replies)
    return built
