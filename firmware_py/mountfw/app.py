"""The loop: hear, move on, one piece of work. Joins the pure parts with a port, the hardware's verbs.

A port has ticks_us(), ticks_ms(), any(wait_ms), drain(receiver, most), pack(ring, at, mask), writable(),
write(c), led(on), start_watchdog(), stop_watchdog(), collect() and undisturbed(action, argument), and for
files what settings.py says. The loop sleeps only in any(), which says whether a byte waits and returns as
soon as one does.

No piece of work takes long: some bytes are parsed, or one message obeyed, or one command of a line, or a few
bytes sent. So whatever comes, the next look at the input and at the switches is less than a millisecond away.
"""

from mountfw import board_file, codes
from mountfw.dialect.commands import Commands
from mountfw.dialect.line import Line
from mountfw.dialect.queries import About
from mountfw.motion.axis import NEVER_US, REST, Axis
from mountfw.motion.bridge import EnableBridge, TwoPwmBridge
from mountfw.motion.controller import Controller
from mountfw.motion.endstop import EndStop
from mountfw.own_reply import OwnReply
from mountfw.store import Records
from mountfw.wire import receiver as wire
from mountfw.wire.error_queue import ErrorQueue
from mountfw.wire.frame import Frame
from mountfw.wire.presize import presize
from mountfw.wire.replies import Replies
from mountfw.wire.ticks import diff

_SPIN_US = 3_000  # a drive that ends within this is waited for: more than a pass takes
_LOOK_US = 200  # of that, the last stretch knows the clock only: more than a look takes
_SHOW_US = 32_000  # between two looks at what the LED should show
_SLEEP_MS = 64  # the longest sleep: half a slot of the LED's patterns
_RUN_SLEEP_MS = 20  # while a run is to be counted
_TAKE = 64  # bytes taken in between two looks at what is due
_TAKE_SPINNING = 2  # the same while a drive is about to end
_STREAM = 32  # so many bytes at once are part of a stream ...
_MUCH = 2048  # ... which is taken in before it is parsed, up to here
_SEND = 4  # bytes sent in one pass
_BEHIND = 64  # with so many bytes yet to be parsed, frames are obeyed without an echo

built = None  # the App that was built last: what repl.py goes on with


def _no_watchdog():
    pass


class App:
    """The firmware of one mount. step() is one pass of the loop and never waits longer than _SLEEP_MS."""

    def __init__(self, port, controller, commands, receiver, frame, replies, own):
        self.controller = controller
        self._commands = commands
        self._records = controller.records
        self.port = port
        self._receiver = receiver
        self._frame = frame
        self._replies = replies
        self._own = own
        self._ticks_us = port.ticks_us
        self._any = port.any
        self._drain = port.drain
        self._look = self.look
        controller.watch_input(self.look)
        self.answers = commands.answers
        self._passed = commands.answers.passed
        self._feed = _no_watchdog  # what feeds it
        self._streams = False  # will more input follow at once?
        self._sleep_ms = 0
        self._shown_at = port.ticks_us()
        self._lit = False

    def run(self):
        """The loop, for ever. An internal fault stops the motors, is queued, and the loop goes on."""
        try:
            self.port.collect()
            self._feed = self.port.start_watchdog()
            while True:
                try:
                    while True:
                        self.step()
                except Exception:
                    self.controller.shutdown(codes.FAULT)
                    self.controller.errors.push(codes.INTERNAL_FAULT)
        finally:  # Ctrl-C: every move ends here and now, so that it is counted right
            self.port.undisturbed(self._leave, codes.ABORTED)

    def _leave(self, reason):
        self.controller.shutdown(reason)
        self.port.stop_watchdog()
        self._feed = _no_watchdog

    def step(self):
        """One pass of the loop."""
        controller = self.controller
        heard = self._any(self._sleep_ms)
        woke_at = now_us = self._ticks_us()
        self._streams = False
        if heard:
            self._hear()
            now_us = self._ticks_us()
        left_us = controller.service(now_us)
        if left_us < _SPIN_US:
            left_us = self._end_drives(now_us)
            woke_at = now_us = self._ticks_us()
        elif not heard:
            self._look()
        self._sleep_ms = 0
        if self._streams:
            pass  # there may be a stop in what is still coming: all else can wait
        elif self._commands.busy:
            self._commands.go_on()
        elif self._receiver.unparsed > self._receiver.ahead:
            self._obey(self._receiver.next())
        elif not heard:  # after a byte the next pass looks at once, so that a pause is seen from its beginning
            self._sleep_ms = self._idle(now_us, left_us)
        now_us = self._ticks_us()
        if diff(now_us, self._shown_at) >= _SHOW_US:
            self._shown_at = now_us
            self.show()
            self._own.tick(now_us)
            self._feed()
        self._passed(diff(now_us, woke_at))

    def _hear(self):
        """Take in all that waits, unless a drive must end first.

        It streams if this was at least half a packet of USB, and there is room for more.
        """
        receiver = self._receiver
        before = receiver.unparsed
        while self._take(_TAKE) and not self._must_end():
            pass
        self._streams = receiver.unparsed - before >= _STREAM and receiver.unparsed < _MUCH

    def _take(self, most):
        """Take in what waits, at most so many bytes; a stop turns off at once. False if no more waits."""
        receiver = self._receiver
        before = receiver.unparsed
        stop = self._drain(receiver, most)
        if stop:
            reason = codes.ABORTED if stop == wire.STOP else codes.STOPPED
            self.controller.stop_all(reason)
            self.controller.hold(reason)
        taken = receiver.unparsed - before
        if taken:
            self.controller.heard_at = self._ticks_us()
        return stop != 0 or taken == most

    def _must_end(self):
        """Serves what drives, and says whether its end is near."""
        return self.controller.driving() and self.controller.service(self._ticks_us()) < _SPIN_US

    def look(self):
        """Take in what waits, in the middle of something, for the sake of a stop in it."""
        if self._any(0):
            self._take(_TAKE)

    def _obey(self, message):
        controller = self.controller
        if not message:
            return
        if message == wire.FRAME:
            frame = self._frame
            controller.frame(frame.m1, frame.m2)
            if self._receiver.unparsed < _BEHIND and not self._own.muted:
                self._replies.echo(frame.packed)  # best effort: nobody is told if it did not fit
        elif message == wire.LINE:
            self._commands.take()
        elif message == wire.STOP:
            controller.stop_all(codes.ABORTED)
        elif message == wire.ZEROS:
            controller.stop_all(codes.STOPPED)
        elif message == wire.SUSPECT:
            controller.suspect(self._frame.m1, self._frame.m2)
        elif message >= wire.OWN_REPLY:
            if message == wire.WAS_OWN_REPLY:
                controller.errors.retract(codes.MALFORMED)
            controller.malformed(codes.OWN_REPLY)
            self._own.returned(self._ticks_us())
        else:
            controller.malformed(codes.MALFORMED if message == wire.MALFORMED else codes.LINE_TOO_LONG)
            self._own.doubt()
        if controller.held and not self._receiver.stops_ahead:
            controller.hold(codes.NONE_YET)

    def _end_drives(self, now_us):
        """The last stretch of what drives: the clock, and bytes that may be a stop; all else waits."""
        axis = self.controller.ending(now_us, _SPIN_US)
        while axis:
            while axis.state > REST and diff(axis.ends_at, self._ticks_us()) > _LOOK_US:
                if self._any(0):
                    self._take(_TAKE_SPINNING)
                else:
                    self.controller.guard_stops()
            if axis.driving():
                axis.cut_on_time()
                self._look()
            axis = self.controller.ending(self._ticks_us(), _SPIN_US)
        left_us = self.controller.service(self._ticks_us())
        self._look()
        return left_us

    def _idle(self, now_us, left_us):
        """Nothing waits: answer, and give up what stays unfinished. Returns the ms that the next pass may sleep."""
        waiting = self._replies.waiting
        if waiting:
            self._answer(now_us)
        quiet_us = self._silence(now_us)
        if quiet_us < left_us:
            left_us = quiet_us
        if self._receiver.unparsed > self._receiver.ahead or self.controller.watching():
            return 0
        if self._records.waiting and not (waiting or self._receiver.gap_us()):
            self._records.record(now_us, self.controller.moving())
        if waiting:
            most_ms = 0 if self.port.writable() else 1
        else:
            most_ms = _RUN_SLEEP_MS if self.controller.driving() else _SLEEP_MS
        if left_us >= NEVER_US:
            return most_ms
        left_us -= _SPIN_US
        return 0 if left_us < 1000 else most_ms if left_us > most_ms * 1000 else left_us // 1000

    def _silence(self, now_us):
        """Is a keep-alive over, or a message given up? Returns the microseconds to the next such deadline."""
        controller = self.controller
        quiet_us = controller.silence(now_us) if controller.keep_alive_ms else NEVER_US
        gap_us = self._receiver.gap_us()
        if gap_us:
            gap_us -= self._silent_us(now_us)
            if gap_us <= 0:
                self._obey(self._receiver.gap())
            elif gap_us < quiet_us:
                return gap_us
        return quiet_us

    def _silent_us(self, now_us):
        """Since when nothing has come; and nothing been sent, if a frame waits for what may come of that."""
        silent_us = diff(now_us, self.controller.heard_at)
        if self._receiver.deciding():
            unsent_us = diff(now_us, self._own.sent_at)
            if 0 <= unsent_us < silent_us:
                return unsent_us
        return silent_us

    def _answer(self, now_us):
        """Send some bytes, if the host takes them. Nothing ever waits for output."""
        left = _SEND
        while left and self._replies.waiting and self.port.writable():
            self.port.write(self._replies.read())
            self._look()
            left -= 1
        if left < _SEND:
            self._own.sent(now_us)

    def show(self):
        """The LED: on = ready, blinking = driving, double blink = an error waits to be read."""
        slot = self.port.ticks_ms() >> 7 & 7
        if self.controller.driving():
            lit = slot & 1 == 0
        elif self.controller.errors.waiting:
            lit = slot == 0 or slot == 2
        else:
            lit = True
        if lit != self._lit:
            self._lit = lit
            self.port.led(lit)


def build(port, board):
    """An App on a port (see ports/), wired as a board file says (see boards/).

    Raises ValueError if that cannot be used.
    """
    global built
    wrong = board_file.fault(board_file.values(board), False)
    if wrong:
        raise ValueError(wrong)
    error_queue = ErrorQueue()
    cause = port.reset_cause()
    own = OwnReply(port.pack)
    replies = Replies(own)
    frame = Frame(port.pack)
    line = Line()
    axes = []
    for number, pins in ((1, board.AXIS_1), (2, board.AXIS_2)):
        if board.BRIDGE == "enable":
            bridge = EnableBridge(
                port.output(pins["en"], board.PWM_HZ),
                port.output(pins["pos"]),
                port.output(pins["neg"]),
                board.DEAD_TIME_US,
                port.pause_us,
                port.ticks_us,
            )
        else:
            bridge = getattr(port, "TwoPwmBridge", TwoPwmBridge)(  # a port may have one of its platform's own
                port.output(pins["pos"], board.PWM_HZ),
                port.output(pins["neg"], board.PWM_HZ),
                board.DEAD_TIME_US,
                port.pause_us,
                port.ticks_us,
            )
        stops = [EndStop(port.reader(pins[name])) for name in ("stop_pos", "stop_neg")]
        axis = Axis(number, bridge, stops[0], stops[1], error_queue, port.ticks_us)
        axes.append(axis)
        for name in ("stop_pos", "stop_neg"):
            if pins[name] is not None:
                port.on_rise(pins[name], axis.guard)
    number = getattr(board, "EMERGENCY_STOP", None)
    emergency_stop = EndStop(port.reader(number))
    emergency_stop.fitted = number is not None
    records = Records(port, axes, error_queue)
    controller = Controller(axes[0], axes[1], error_queue, emergency_stop, records, port.boot_id(), port.ticks_ms)
    if cause == codes.WATCHDOG:
        error_queue.push(codes.WATCHDOG_RESET)
    about = About(board.NAME, port.unique_id(), port.firmware_hash(), cause, port.free_memory)
    if number is not None:
        port.on_rise(number, controller.guard)
    commands = Commands(controller, line, replies, about)
    receiver = wire.Receiver(frame, line, port.pack, own)
    built = App(port, controller, commands, receiver, frame, replies, own)
    for thing, most in ((receiver, 18), (frame, 13), (replies, 13), (own, 24), (controller, 18)):
        presize(thing, most)
    for axis in axes:
        for thing, most in ((axis, 60), (axis.position, 18), (axis.bridge, 13)):
            presize(thing, most)
    return built
