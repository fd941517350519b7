"""The loop: receive, service the axes, do one piece of work. build.py makes an App; this imports no port.

A port is the hardware's verbs; tests/firmware/port_protocol.py lists them. The loop sleeps only in look(), the
port's or that of look.py, which returns as soon as a byte waits. docs/architecture.md walks through it.
"""

from mountfw import codes, const, led
from mountfw.wire import receiver as wire
from mountfw.wire.ticks import diff

_SPIN_US = const(3_000)  # a drive that ends within this is waited for: more than a pass takes
_SOON_US = const(7_000)  # a pass that meets a burst may take so long: with this left, it reads few bytes at once
_FREE_US = const(10_000)  # nothing is due for so long: a pass may read more, and take twice as long as others
_SHOW_US = const(32_000)  # between two updates of the LED
_SILENCE_US = const(2_000_000)  # after it the port is no longer known not to return what is sent
_READ = const(64)  # bytes read at once
_READ_MEANWHILE = const(16)  # the same in the middle of longer work
_FEW = const(4)  # the same while something is due soon; and bytes sent in one pass
_PARSED = const(5)  # pieces of parsing in one pass: a line's first byte is two
_READ_SPINNING = const(2)  # while a drive is about to end
_REST_MS = const(40)  # the loop sleeps on for the rest of a frame, at most so long: less than FRAME_GAP_US
_STREAM = const(32)  # so many bytes at once are part of a stream ...
_MOST_STREAMED = const(2048)  # ... which is read before it is parsed, up to here
_STOPS = {wire.STOP: codes.ABORTED, wire.ZEROS: codes.STOPPED}  # and their reasons
_NOTHING = const(0)  # what was read, of what waited
_ALL = const(1)
_MORE = const(2)
_CLOSED = const(-1)  # no wait, in the middle of other work: the lane (docs/lane.md) may take no frame
_BEHIND = const(64)  # with so many bytes yet to be parsed, frames are executed without an echo


class App:
    """The firmware of one mount. run_once() is one pass of the loop and never waits longer than a slot of the LED."""

    built: "App | None" = None  # the one that build.py has made: repl.py continues with it

    def __init__(self, port, controller, commands, receiver, frame, replies, gated, lane):
        self.controller = controller
        self.gated = gated
        self._commands = commands
        self._records = controller.records
        self.port = port
        self._receiver = receiver
        self._frame = frame
        self._replies = replies
        self._lane, self._look = lane, lane.look
        self._ticks_us = port.ticks_us
        self.queries = commands.queries
        self._about = commands.queries.about
        self._feed = None  # feeds the watchdog, while it runs
        self._streams = self._obeyed = False  # of this pass: is a stream coming in, has the lane taken a frame?
        self._sleep_ms = self._since = 0  # the latter: when this pass began, or the sleep before it
        self._most, self._meanwhile = _READ, _READ_MEANWHILE  # bytes read at once, and in the middle of longer work
        self._shown_at = port.ticks_us()
        self._watch = self._poll_and_watch  # bound once: nothing is allocated in the loop
        self.poll_by(self.poll_input, self._read)

    def run(self):
        """Run the loop for ever. An internal fault stops the motors, queues an error, and the loop continues."""
        self.poll_by(self.poll_input, self._read)  # again: _leave() has taken it away
        self._replies.silence()
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

    def poll_by(self, poll_input, read):
        """What takes long calls poll_input now and then; read where it may be left for a frame."""
        for part in self.controller.axes + (self._records, self._lane):
            part.poll_input = poll_input
        for axis in self.controller.axes:
            axis.read = read

    def _leave(self, reason):
        self.poll_by(bool, bool)  # does nothing: what comes now is the prompt's
        self._lane.lose()
        self.controller.shutdown(reason)
        self.gated.leave(self._ticks_us)
        self.port.stop_watchdog()
        self._feed = None

    def run_once(self):
        """Run one pass of the loop."""
        self._obeyed = False
        received = self._receive()
        now_us = self._ticks_us()
        left_us = self.controller.service(now_us)
        free = left_us >= _FREE_US
        self._meanwhile = _READ_MEANWHILE if left_us >= _SOON_US else _FEW
        self._most = _READ if free else self._meanwhile
        if left_us < _SPIN_US:
            left_us = self._end_drives(now_us)
            if left_us < _SPIN_US:  # counting took long; no more often, for in a train of pulses this is always so
                left_us = self._end_drives(self._ticks_us())
            self._since = now_us = self._ticks_us()
        shows = diff(now_us, self._shown_at) >= _SHOW_US
        if shows or not received:
            self._read(0)
        if shows:
            self._shown_at = now_us
            led.show(self.port, self.controller)
            self._read(0)
            if diff(now_us, self._receiver.received_at) >= _SILENCE_US:
                self._replies.silence()
            if self._feed:
                self._feed()
            self._read(0)  # a stop does not wait for this and for what follows
        self._sleep_ms = 0
        if self._streams or self._obeyed or self.controller.halted:
            self.poll_input()  # all else can wait: a stop may be in the bytes to come, or the lane take what comes next
        elif self._commands.busy:
            self._commands.go_on()
        elif self._receiver.waits():
            self._parse(free)
        elif not received:  # after a byte the next pass polls at once: silence is measured from its start
            self._sleep_ms = self._idle(now_us, left_us)
        now_us = self._ticks_us()
        self._about.passed(diff(now_us, self._since))
        self._since = now_us

    def _receive(self):
        """Sleep until a byte comes, and read all that wait, unless a drive must end first. True if there were any."""
        before = self._receiver.unparsed
        deaf = self._sleep_ms and self._replies.waiting
        received = found = self._wait_deaf(self._sleep_ms * 1000) if deaf else self._read(self._sleep_ms)
        # a part of a frame does not end the sleep: nothing is due before
        while found == _ALL and self._sleep_ms and not (deaf or self._obeyed) and self._receiver.begun():
            left_ms = self._sleep_ms - 1 - diff(self._ticks_us(), self._since) // 1000
            found = left_ms > 0 and self._read(min(left_ms, _REST_MS))
        self._since = self._lane.woke_at
        while found == _MORE and not self._obeyed:
            if self.controller.driving() and self.controller.service(self._ticks_us()) < _SPIN_US:
                break
            found = self._read(0)
        # will more follow at once? This was at least half a packet of USB, and the ring has room
        self._streams = self._receiver.unparsed - before >= _STREAM and self._receiver.unparsed < _MOST_STREAMED
        return received

    def _wait_deaf(self, left_us):
        """The host does not read: it is asked again and again, but less and less often. As _read()."""
        found = self._read(1)
        nap_ms = 1
        while found == _NOTHING and nap_ms and not self.port.writable():
            left_ms = (left_us - diff(self._ticks_us(), self._since)) // 1000
            nap_ms = max(0, min(2 * nap_ms, left_ms, 32))  # so late it sees at most that the host reads again
            found = self._read(nap_ms)
        return found

    def _read(self, wait_ms, most=0):
        """Wait so long for a byte, read at most so many; a stop cuts, a frame may drive. _NOTHING, _ALL or _MORE."""
        receiver = self._receiver
        most = most or self._most
        before = receiver.write
        stop = self._look(most, wait_ms)
        if stop < 0:
            return _NOTHING
        if stop:
            self._halt(stop)
        if self._lane.log[0]:
            self._obeyed = True
            self._lane.book()
        return _MORE if stop or receiver.write - before & receiver.mask == most else _ALL

    def poll_input(self, most=0):
        """Read bytes that wait, in the middle of longer work: a stop among them cuts at once. True if any came."""
        stop = self._look(most or self._meanwhile, _CLOSED)
        if stop > 0:
            self._halt(stop)
        return stop >= 0

    def _poll_and_watch(self, most):
        """The same, and look at the switches."""
        self.poll_input(most)
        self.controller.guard_stops()

    def _halt(self, stop):
        self.gated.received += 1
        self.controller.halt(_STOPS[stop])

    def _parse(self, free):
        receiver = self._receiver
        if self._read(0, self._meanwhile) and (self._obeyed or self.controller.halted):
            return  # the lane has taken a frame whose last byte came now
        message = wire.NEED_BYTES
        for _ in range(_PARSED):
            message = receiver.next()
            if message or receiver.unparsed == receiver.ahead:
                break
            self.poll_input()
        if message:
            self.poll_input()
            self._dispatch(message)
        elif receiver.ahead:
            self._read(0)
        if self._commands.busy and free and not (self.controller.halted or self.controller.watching()):
            self._commands.go_on()  # many short lines: half of their time is the pass around them

    def _dispatch(self, message):
        """Execute a message of Receiver.next() or gap()."""
        controller = self.controller
        if message == wire.FRAME:
            frame = self._frame
            controller.frame(frame.m1, frame.m2)
            if self._receiver.unparsed < _BEHIND:
                self._replies.echo(frame.packed)  # best effort: one that does not fit is dropped
        elif message == wire.LINE:
            self._commands.start()
        elif message in _STOPS:
            controller.stop_all(_STOPS[message])
        elif message:
            controller.malformed(codes.LINE_TOO_LONG if message == wire.TOO_LONG else codes.MALFORMED)
            self._replies.doubt(message == wire.RETURNED)
        if controller.inhibited and not self._receiver.stops_ahead and self.gated.released():
            controller.inhibit(codes.NONE_YET)

    def _end_drives(self, now_us):
        """Cut each drive that ends soon, on time; only clock and bytes are read. Returns us to the next deadline."""
        controller = self.controller
        axis = controller.ending(now_us, _SPIN_US)
        watching = axis and controller.watching()
        while axis:
            axis.drive.end_on_time(self._watch if watching else axis.poll_input, _READ_SPINNING)
            axis = controller.ending(self._ticks_us(), _SPIN_US)
        self.poll_input()
        return controller.service(self._ticks_us())

    def _idle(self, now_us, left_us):
        """Send replies, check timeouts, record positions: no input waits. Returns the next pass's sleep in ms."""
        if self._replies.waiting:
            self._send()
        self.gated.watch(self._receiver)
        looked_us = self._ticks_us()
        if self._heard():
            return 0
        gap_us = self._receiver.gap_us()
        left_us = self._time_out(looked_us, left_us, gap_us)
        if not left_us or self.controller.watching():  # twice in a pass, for a port without interrupts
            self.controller.guard_stops()
            return 0
        if self._heard() or (self._replies.waiting and self.port.writable()):
            return 0
        left_us -= diff(self._ticks_us(), now_us) + _SPIN_US
        left_ms = max(0, left_us // 1000)
        if left_ms >= led.SLOT_MS:
            left_ms = max(_SHOW_US // 1000, led.SLOT_MS - self.port.ticks_ms() % led.SLOT_MS)
        if not (self._replies.waiting or gap_us or self.controller.moving()) and self._records.rest(now_us):
            return 0
        return 0 if self._heard() else left_ms

    def _heard(self):
        """Look once more. True if there is something to do before the loop sleeps."""
        receiver = self._receiver
        return self._read(0) or receiver.unparsed > receiver.ahead or self._obeyed or self.controller.halted

    def _time_out(self, now_us, left_us, gap_us):
        """Apply the keep-alive, and the gap after an unfinished message. Returns the us to the next deadline of all."""
        due_us = left_us
        if self.controller.keep_alive_ms:
            due_us = self.controller.silence(now_us, self._receiver.received_at)
        if gap_us:
            gap_us -= diff(now_us, self._receiver.received_at)
            if gap_us <= 0:
                self._dispatch(self._receiver.gap())
                return 0  # it may have begun a drive
            return min(left_us, due_us, gap_us)
        while due_us < _SPIN_US and due_us < left_us and not self.poll_input():  # its end is waited for
            self.controller.guard_stops()
            due_us = self.controller.silence(now_us, self._receiver.received_at)  # up to then no byte had come
            now_us = self._ticks_us()
        return min(left_us, due_us)

    def _send(self):
        """Send some bytes of the replies, if the host reads. Output never blocks."""
        left = _FEW
        while left and self._replies.waiting and self.port.writable():
            self.port.write(self._replies.read())
            self._read(0)
            left -= 1
