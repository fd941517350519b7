"""The loop: read, service the axes, do one piece of work. build.py makes an App; this imports no port.

A port is the hardware's verbs; tests/firmware/port_protocol.py lists them. The loop sleeps only in Input.read(), which
returns as soon as a byte waits. docs/architecture.md walks through it.
"""

from mountfw import codes, const
from mountfw.wire import receiver as wire
from mountfw.wire.frame import LENGTH
from mountfw.wire.ticks import diff

_SPIN_US = const(3_000)  # a drive that ends within this is waited for: more than a pass takes
_SOON_US = const(7_000)  # with less left until something is due, few bytes are read at once
_FREE_US = const(10_000)  # nothing is due for so long: a pass may take twice as long as others
_SHOW_US = const(32_000)  # between two updates of the LED
_SLOT_MS = const(512)  # of the LED: the loop sleeps to the end of one, for asleep it obeys a stop soonest
_SILENCE_US = const(2_000_000)  # after such a silence it is unknown again whether the port returns what the board sends
_READ = const(64)  # bytes read at once: a packet of USB
_READ_MEANWHILE = const(16)  # the same in the middle of longer work
_FEW = const(4)  # the same while something is due soon; and bytes sent in one pass
_READ_SPINNING = const(2)  # the same while a drive is about to end
_PARSED = const(5)  # pieces of parsing in one pass: a line's first byte is two
_REST_MS = const(40)  # the loop sleeps on for the rest of a frame, at most so long: less than FRAME_GAP_US
_MOST_STREAMED = const(2048)  # a burst is read before it is parsed, up to here
_BEHIND = const(64)  # with so many bytes yet to be parsed, frames are executed without an echo
_STOPS = {wire.STOP: codes.ABORTED, wire.ZEROS: codes.STOPPED}  # and their reasons


class Input:
    """Bytes from a port into the ring of a Receiver. A port may have an input of its own, which may even drive at a
    frame: then book() counts what that has driven.
    """

    def __init__(self, port, receiver):
        self._any = port.any
        self._drain = port.drain
        self._ticks_us = port.ticks_us
        self._receiver = receiver
        self.woke_at = 0  # when the last wait was over
        self.check_stop = bool  # for book(), as of an Axis

    def read(self, most, wait_ms):
        """Wait so long for a byte, and read at most so many, no further than to a stop.

        Returns that stop or NEED_BYTES; -1 if no byte came. wait_ms is -1 in the middle of other work: no wait, and
        nothing but a stop is obeyed.
        """
        came = self._any(max(0, wait_ms))
        self.woke_at = self._ticks_us()
        if not came:
            return -1
        stop = self._drain(self._receiver, most)
        self._receiver.received_at = self._ticks_us()
        return stop

    def book(self):
        """Count the frames that read() has driven, each as if executed when it came. True if there are any."""
        return False

    def lose(self):
        """Ctrl-C, or a fault, may have come between a frame's drive and its count."""


class App:
    """The firmware of one mount. run_once() is one pass of the loop and never waits longer than a slot of the LED."""

    built: "App | None" = None  # the one that build.py has made: repl.py continues with it

    def __init__(self, port, controller, commands, receiver, frame, replies, gated, source):
        self.controller = controller
        self.gated = gated
        self.port = port
        self.queries = commands.queries
        self._commands = commands
        self._records = controller.records
        self._receiver = receiver
        self._frame = frame
        self._replies = replies
        self._input = source
        self._ticks_us = port.ticks_us
        self._about = commands.queries.about
        self._feed = None  # feeds the watchdog, while it runs
        self._sleep_ms = 0
        self._since = 0  # when this pass began, or the sleep before it
        self._meanwhile = _READ_MEANWHILE
        self._shown_at = port.ticks_us()
        self._watch = self._poll_and_watch  # bound once: nothing is allocated in the loop
        self.poll_by(self.check_stop)

    def run(self):
        """Run the loop for ever. An internal fault stops the motors, queues an error, and the loop continues."""
        self.poll_by(self.check_stop)  # again: _leave() has taken it away
        self._replies.silence()
        try:
            self.gated.enter()
            self._feed = self.port.start_watchdog()
            while True:
                try:
                    self.run_once()
                except Exception:
                    self._input.lose()
                    self.controller.shutdown(codes.FAULT)
                    self.controller.errors.push(codes.INTERNAL_FAULT)
        finally:  # Ctrl-C: every move ends at once, so that it is counted right
            self.port.uninterrupted(self._leave, codes.ABORTED)

    def poll_by(self, check_stop):
        """What takes long calls check_stop now and then: a stop does not wait for it."""
        for part in self.controller.axes + (self._records, self._input):
            part.check_stop = check_stop

    def _leave(self, reason):
        self.poll_by(bool)  # does nothing: what comes now is the prompt's
        self._input.lose()
        self.controller.shutdown(reason)
        self.gated.leave(self._ticks_us)
        self.port.stop_watchdog()
        self._feed = None

    def run_once(self):
        """Run one pass of the loop."""
        received = self._receive()
        now_us = self._ticks_us()
        left_us = self.controller.service(now_us)
        self._meanwhile = _READ_MEANWHILE if left_us >= _SOON_US else _FEW
        free = left_us >= _FREE_US
        if left_us < _SPIN_US:
            left_us = self._end_drives(now_us)
            if (
                left_us < _SPIN_US
            ):  # counting took long: look once more, not in a loop, for in a train of pulses an end is always near
                left_us = self._end_drives(self._ticks_us())
            self._since = now_us = self._ticks_us()
        if diff(now_us, self._shown_at) >= _SHOW_US:
            self._show(now_us)
        self._sleep_ms = 0
        if received == _READ and self._receiver.unparsed < _MOST_STREAMED:
            pass  # more will follow at once, maybe a stop: it is read before this is parsed
        elif self.controller.halted:
            self.check_stop()
        elif self._commands.busy:
            self._commands.go_on()
        elif self._receiver.waits():
            self._parse(free)
        elif not received:  # after a byte the next pass polls at once: only a pass without a byte may measure a silence
            self._sleep_ms = self._idle(now_us, left_us)
        now_us = self._ticks_us()
        self._about.passed(diff(now_us, self._since))
        self._since = now_us

    # ---- reading

    def _receive(self):
        """Sleep until a byte comes, and read those that wait. Returns how many."""
        if self._sleep_ms and self._replies.waiting:
            return self._wait_deaf(self._sleep_ms)
        received = self._read(self._sleep_ms)
        more = received
        while 0 < more < LENGTH and self._sleep_ms and self._receiver.begun():  # a part of a frame: nothing is due
            left_ms = self._sleep_ms - 1 - diff(self._ticks_us(), self._since) // 1000
            more = self._read(min(left_ms, _REST_MS)) if left_ms > 0 else 0
        self._since = self._input.woke_at
        return received

    def _wait_deaf(self, left_ms):
        """The host does not read: it is asked again and again, but less and less often. As _read()."""
        received = self._read(1)
        nap_ms = 1
        while not received and nap_ms and not self.port.writable():
            left_ms = self._sleep_ms - diff(self._ticks_us(), self._since) // 1000
            nap_ms = max(
                0, min(2 * nap_ms, left_ms, 32)
            )  # the loop notices at most this late that the host reads again
            received = self._read(nap_ms)
        self._since = self._input.woke_at
        return received

    def _read(self, wait_ms):
        """Wait so long for a byte, and read those that wait: a stop cuts, and frames may drive. Returns how many."""
        before = self._receiver.write
        stop = self._input.read(_READ if self._meanwhile > _FEW else _FEW, wait_ms)
        if stop > 0:
            self._halt(stop)
        if self._input.book():
            return LENGTH
        return self._receiver.write - before & self._receiver.mask

    def check_stop(self, most=0):
        """Read bytes that wait, in the middle of longer work: a stop among them cuts at once. True if any came."""
        stop = self._input.read(most or self._meanwhile, -1)
        if stop > 0:
            self._halt(stop)
        return stop >= 0

    def _poll_and_watch(self, most):
        """The same, and look at the switches."""
        self.check_stop(most)
        self.controller.guard_stops()

    def _halt(self, stop):
        self.gated.received += 1
        self.controller.halt(_STOPS[stop])

    # ---- work

    def _parse(self, free):
        receiver = self._receiver
        message = wire.NEED_BYTES
        for _ in range(_PARSED):
            message = receiver.next()
            if message or receiver.unparsed == receiver.ahead:
                break
        self.check_stop()
        if message:
            self._dispatch(message)
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
            axis.drive.end_on_time(self._watch if watching else axis.check_stop, _READ_SPINNING)
            axis = controller.ending(self._ticks_us(), _SPIN_US)
        self.check_stop()
        return controller.service(self._ticks_us())

    def show_led(self):
        """Switch the LED by the state of the mount and by the clock."""
        slots = 0b00010001 if self.controller.errors.waiting else 0b11111111  # eight, the lowest bit first
        if self.controller.driving():
            slots = 0b01010101
        self.port.led(slots >> (self.port.ticks_ms() // _SLOT_MS & 7) & 1)

    def _show(self, now_us):
        """Feed the watchdog, and update the LED: on = ready, blinking = driving, a flash each 2 s = an error waits."""
        self._shown_at = now_us
        if self._feed:
            self._feed()
        self.show_led()
        if diff(now_us, self._receiver.received_at) >= _SILENCE_US:
            self._replies.silence()
        self.check_stop()

    # ---- nothing to do

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
        if self._replies.waiting and self.port.writable():
            return 0
        left_us -= diff(self._ticks_us(), now_us) + _SPIN_US
        left_ms = max(0, left_us // 1000)
        if left_ms >= _SLOT_MS:
            left_ms = max(_SHOW_US // 1000, _SLOT_MS - self.port.ticks_ms() % _SLOT_MS)
        if not (self._replies.waiting or gap_us or self.controller.moving()) and self._records.rest(now_us):
            return 0
        return 0 if self._heard() else left_ms

    def _heard(self):
        """Poll once more. True if there is something to do before the loop sleeps."""
        return self.check_stop() or self._receiver.unparsed > self._receiver.ahead or self.controller.halted

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
        while due_us < _SPIN_US and due_us < left_us and not self.check_stop():  # the keep-alive ends soon: wait for it
            self.controller.guard_stops()
            due_us = self.controller.silence(
                now_us, self._receiver.received_at
            )  # read before the last poll, which found no byte
            now_us = self._ticks_us()
        return min(left_us, due_us)

    def _send(self):
        """Send some bytes of the replies, if the host reads. Output never blocks."""
        left = _FEW
        while left and self._replies.waiting and self.port.writable():
            self.port.write(self._replies.read())
            left -= 1
        self.check_stop()
