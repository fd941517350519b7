"""The loop: receive, service the axes, do one piece of work. build.py makes an App; this imports no port.

A port is the hardware's verbs; tests/firmware/port_protocol.py lists them. The loop sleeps only in look(), the
port's or that of extras.py, which returns as soon as a byte waits. docs/architecture.md walks through it.
"""

from mountfw import codes
from mountfw.motion.axis import REST
from mountfw.motion.drive import NEVER_US
from mountfw.wire import receiver as wire
from mountfw.wire.ticks import diff

_SPIN_US = 3_000  # a drive that ends within this is waited for: more than a pass takes
_CLOCK_US = 200  # of that, the last stretch reads the clock only: more than polling the input takes
_SHOW_US = 32_000  # between two updates of the LED
_SLEEP_MS = 64  # the longest sleep: half a slot of the LED's patterns
_RUN_SLEEP_MS = 20  # while a run is to be counted
_READ = 64  # bytes read between two checks of the deadlines
_READ_SPINNING = 2  # the same while a drive is about to end
_STREAM = 32  # so many bytes at once are part of a stream ...
_MOST_STREAMED = 2048  # ... which is read before it is parsed, up to here
_STOPS = {wire.STOP: codes.ABORTED, wire.ZEROS: codes.STOPPED}  # and their reasons
_NOTHING, _ALL, _MORE = range(3)  # what was read, of what waited
_SEND = 4  # bytes sent in one pass
_BEHIND = 64  # with so many bytes yet to be parsed, frames are executed without an echo

# the LED in eight slots of 128 ms, the lowest bit first
_DRIVES, _ERROR_WAITS, _READY = 0b01010101, 0b00000101, 0b11111111


class App:
    """The firmware of one mount. run_once() is one pass of the loop and never waits longer than _SLEEP_MS."""

    built: "App | None" = None  # the one that build.py has made: repl.py continues with it

    def __init__(self, port, controller, commands, receiver, frame, replies, own, gated, lane):
        self.controller = controller
        self.gated = gated
        self._commands = commands
        self._records = controller.records
        self.port = port
        self._receiver = receiver
        self._frame = frame
        self._replies = replies
        self._own = own
        self._look = lane.look
        self._lane = lane
        self._ticks_us = port.ticks_us
        self._any = port.any
        controller.records.poll_input = self.poll_input
        self.queries = commands.queries
        self._passed = commands.queries.passed
        self._feed = None  # feeds the watchdog, while it runs
        self._tidy = False  # is what the start has left collected?
        self._sleep_ms = self._lit = 0
        self._shown_at = port.ticks_us()

    def run(self):
        """Run the loop for ever. An internal fault stops the motors, queues an error, and the loop continues."""
        try:
            self.gated.enter()
            self._feed = self.port.start_watchdog()
            while True:
                try:
                    self.run_once()
                except Exception:
                    self._lane.lose()
                    self.controller.shutdown(codes.FAULT)
                    self.controller.errors.push(codes.INTERNAL_FAULT)
        finally:  # Ctrl-C: every move ends at once, so that it is counted right
            self.port.uninterrupted(self._leave, codes.ABORTED)

    def _leave(self, reason):
        self._lane.lose()
        self.controller.shutdown(reason)
        self.gated.leave(self._ticks_us)
        self.port.stop_watchdog()
        self._feed = None

    def run_once(self):
        """Run one pass of the loop."""
        self._obeyed = False  # does the lane take frames in this pass?
        received = self._receive(self._sleep_ms)
        now_us = self._ticks_us()
        if diff(now_us, self._shown_at) >= _SHOW_US:
            self._shown_at = now_us
            self.show()
            self._own.tick(now_us)
            if self._feed:
                self._feed()
            self._take(0)  # a stop does not wait for this and for the axes
        left_us = self.controller.service(now_us)
        if left_us < _SPIN_US:
            left_us = self._end_drives(now_us)
            self._woke_at = now_us = self._ticks_us()
        elif not received and self._any(0):
            self._take(0)
        self._sleep_ms = 0
        if self._streams or self._obeyed:
            pass  # a stop may be in the bytes still to come, or the lane take what comes next: everything else can wait
        elif self._commands.busy:
            self._commands.go_on()
        elif self._receiver.unparsed > self._receiver.ahead:
            self._dispatch(self._receiver.next())
        elif not received:  # after a byte the next pass polls at once: silence is measured from its start
            self._sleep_ms = self._idle(now_us, left_us)
        self._passed(diff(self._ticks_us(), self._woke_at))

    def _receive(self, wait_ms):
        """Wait so long for a byte, and read all that wait, unless a drive must end first. True if there were any."""
        receiver = self._receiver
        before = receiver.unparsed
        found = received = self._take(wait_ms)
        self._woke_at = self._lane.woke_at
        while found == _MORE:
            if self.controller.driving() and self.controller.service(self._ticks_us()) < _SPIN_US:
                break
            found = self._read(_READ)
        # will more follow at once? This was at least half a packet of USB, and the ring has room
        self._streams = receiver.unparsed - before >= _STREAM and receiver.unparsed < _MOST_STREAMED
        return received

    def _take(self, wait_ms):
        """As _read(), where nothing is under way: a frame may be obeyed at once."""
        self._lane.open()
        return self._read(_READ, wait_ms)

    def _read(self, most=_READ, wait_ms=0):
        """Wait so long for a byte, and read at most so many; a stop turns off at once. _NOTHING, _ALL or _MORE."""
        receiver = self._receiver
        before = receiver.write
        stop = self._look(most, wait_ms)
        if stop < 0:
            return _NOTHING
        count = receiver.write - before & receiver.mask
        if count:  # else a frame was taken that had come before
            self.controller.received_at = self._ticks_us()
        if self._lane.log[0]:
            self._obeyed = True
            stop = self._lane.book(stop)
        if stop:
            self.gated.received += 1
            self.controller.stop_all(_STOPS[stop])
            self.controller.inhibit(_STOPS[stop])
        return _MORE if stop or count == most else _ALL

    def poll_input(self):
        """Read the bytes that wait, in the middle of longer work: a stop among them acts at once."""
        if self._any(0):
            self._read()

    def _dispatch(self, message):
        """Execute a message of Receiver.next() or Receiver.gap()."""
        controller = self.controller
        if message == wire.FRAME:
            frame = self._frame
            controller.frame(frame.m1, frame.m2)
            if self._receiver.unparsed < _BEHIND and not self._own.muted:
                self._replies.echo(frame.packed)  # best effort: one that does not fit is dropped
        elif message == wire.LINE:
            self._commands.start()
        elif message in _STOPS:
            controller.stop_all(_STOPS[message])
        elif message == wire.SUSPECT:
            controller.suspect(self._frame.m1, self._frame.m2)
        elif message >= wire.OWN_REPLY:
            if message == wire.WAS_OWN_REPLY:
                controller.errors.retract(codes.MALFORMED)
            controller.malformed(codes.OWN_REPLY)
            self._own.returned(self._ticks_us())
        elif message:
            controller.malformed(codes.MALFORMED if message == wire.MALFORMED else codes.LINE_TOO_LONG)
            self._own.doubt()
        if controller.inhibited and not self._receiver.stops_ahead and self.gated.released():
            controller.inhibit(codes.NONE_YET)

    def _end_drives(self, now_us):
        """Cut each drive that ends soon, on time; only clock and bytes are read. Returns us to the next deadline."""
        axis = self.controller.ending(now_us, _SPIN_US)
        while axis:
            while axis.state > REST and diff(axis.drive.ends_at, self._ticks_us()) > _CLOCK_US:
                if self._any(0):
                    self._read(_READ_SPINNING)
                else:
                    self.controller.guard_stops()
            if axis.driving():
                axis.drive.cut_on_time()
                self.poll_input()
            axis = self.controller.ending(self._ticks_us(), _SPIN_US)
        self.poll_input()
        return self.controller.service(self._ticks_us())

    def _idle(self, now_us, left_us):
        """Send replies, check timeouts, record positions: no input waits. Returns the next pass's sleep in ms."""
        waiting = self._replies.waiting
        if waiting:
            self._send(now_us)
        self.gated.watch(self._receiver)
        left_us = min(left_us, self._time_out(now_us, left_us))
        self.poll_input()
        if self._receiver.unparsed > self._receiver.ahead or self._obeyed or self.controller.watching():
            return 0
        if not (self._tidy or waiting or self.controller.moving()):  # 20 ms, so after the first answer
            self._tidy = True
            self.port.collect()
        if self._records.waiting and not (waiting or self._receiver.gap_us()):
            self._records.record(now_us, self.controller.moving())
        if waiting:
            most_ms = 0 if self.port.writable() else 1
        else:
            most_ms = _RUN_SLEEP_MS if self.controller.driving() else _SLEEP_MS
        return max(0, min(most_ms, (left_us - _SPIN_US) // 1000))

    def _time_out(self, now_us, due_us):
        """Apply the keep-alive, and the gap after an unfinished message. Returns the us to the next such deadline."""
        left_us = self.controller.silence(now_us) if self.controller.keep_alive_ms else NEVER_US
        gap_us = self._receiver.gap_us()
        if not gap_us:
            while left_us < _SPIN_US and left_us < due_us and not self._any(0):  # its end is waited for
                self.controller.guard_stops()
                left_us = self.controller.silence(now_us)  # up to then no byte had come
                now_us = self._ticks_us()
            return left_us
        silent_us = diff(now_us, self.controller.received_at)
        if self._receiver.deciding():  # a frame is held: silence is that of both directions
            silent_us = min(silent_us, diff(now_us, self._own.sent_at) & 0x3FFFFFFF)  # it may be long ago
        if silent_us >= gap_us:
            self._dispatch(self._receiver.gap())
            return left_us
        return min(left_us, gap_us - silent_us)

    def _send(self, now_us):
        """Send some bytes of the replies, if the host reads. Output never blocks."""
        left = _SEND
        while left and self._replies.waiting and self.port.writable():
            self.port.write(self._replies.read())
            if self._any(0):
                self._take(0)
            left -= 1
        if left < _SEND:
            self._own.sent(now_us)

    def show(self):
        """Update the LED: on = ready, blinking = driving, double blink = an error waits to be read."""
        slots = _DRIVES if self.controller.driving() else _ERROR_WAITS if self.controller.errors.waiting else _READY
        lit = slots >> (self.port.ticks_ms() >> 7 & 7) & 1
        if lit != self._lit:
            self._lit = lit
            self.port.led(lit)
