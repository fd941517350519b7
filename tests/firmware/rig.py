"""A board for tests of the firmware core, in one process and in virtual time.

Runs under CPython and under MicroPython: plain asserts, no pytest. The port below has the verbs
of ports/micropython.py; its clock wraps at 2**30 and starts half a second before it, each verb
costs about what it costs on a board, and an idle wait jumps to the next byte that was scheduled.
"""

from mountfw import boards, build
from mountfw.boards import pico
from mountfw.wire import frame

try:
    from micropython import heap_lock, heap_unlock
except ImportError:  # CPython

    def heap_lock():
        pass

    def heap_unlock():
        pass


WRAP = 1 << 30
START_US = WRAP - 500_000


class Board:
    """The Pico's board file, copied, so that a test may change it."""

    def __init__(self, like=pico):
        self.NAME = like.NAME
        self.BRIDGE = like.BRIDGE
        self.AXIS_1 = like.AXIS_1
        self.AXIS_2 = like.AXIS_2
        self.PWM_HZ = like.PWM_HZ
        self.DEAD_TIME_US = like.DEAD_TIME_US
        self.LED = like.LED


class Port:
    """Virtual time, scheduled input, recorded pins."""

    # Does a duty take effect only when the PWM's period ends? Then an enable may outlast two legs that a stop has
    # brought low: nothing drives the motor, and the enable is low within a period.
    ENABLE_IS_LATE = False

    TUNABLE = True

    clock_us = 3  # what a reading of the clock takes

    def __init__(self, files=None):
        self.us = START_US  # absolute; the firmware sees it modulo 2**30
        self.horizon_us = START_US  # a wait ends here, so that a test gets its turn
        self.inbox = []  # (absolute us, byte), in order
        self.taken = 0  # of these
        self.sent = bytearray()
        self.reading = True  # does the host collect what is sent?
        self.locked = False  # does the heap have to be unlocked for our own notes?
        self.pins = {}
        self.hz = {}  # of the pins that have a PWM
        self.edges = []  # (us since start, pin, duty 0 ... 65535)
        self.switches = {}  # pin: 0 or 1; what is not here is pulled up
        self.analogs = {}  # of analog inputs: 0 ... 65535
        self.lit = None
        self.handlers = {}  # of pins that have an interrupt; unused as a rule, so that switches are polled
        self.opens = None  # the switch that is to open ...
        self.instants = -1  # ... after so many readings of the clock or writes to a pin
        self.fed_at = None  # when the watchdog was fed last; None: it is off
        self.shown = []  # (us since start, LED on?), each change
        self.files = {} if files is None else files  # name: bytes
        self.file_log = []  # (us since start, what was done, name)
        self.full = False  # does the file system refuse to change?

    def ticks_us(self):
        self.us += self.clock_us
        self.instant()
        return self.us & (WRAP - 1)

    def ticks_ms(self):
        self.us += 3
        return (self.us // 1000) & (WRAP - 1)

    def analog(self, number):
        def read():
            self.us += 30
            return self.analogs.get(number, 0)

        return read

    def any(self, wait_ms):
        self.us += 5
        at = self.next_us()
        if at <= self.us:
            return True
        until = min(self.us + wait_ms * 1000, max(self.us, self.horizon_us))
        if at <= until:
            self.us = at
            return True
        self.us = until
        return False

    def pack(self, ring, at, mask):
        self.us += 15
        return frame.pack(ring, at, mask)

    def drain(self, receiver, most):
        for _ in range(most):
            if receiver.unparsed > receiver.mask or self.next_us() > self.us:
                break
            self.us += 24
            c = self.inbox[self.taken][1]
            self.taken += 1
            stop = receiver.receive(c)
            if stop:
                return stop
        return 0

    def next_us(self):
        """When the next byte is there; never, if none was sent."""
        return self.inbox[self.taken][0] if self.taken < len(self.inbox) else 1 << 60

    def writable(self):
        self.us += 5
        return self.reading

    def write(self, c):
        assert self.reading, "wrote to a host that does not read: this would block"
        self.us += 10
        self.unlock()
        self.sent.append(c)
        self.lock()

    def led(self, on):
        if on != self.lit:
            self.lit = on
            self.unlock()
            self.shown.append((self.us - START_US, on))
            self.lock()

    def unlock(self):
        if self.locked:
            heap_unlock()

    def lock(self):
        if self.locked:
            heap_lock()

    def pause_us(self, us):
        self.us += us

    def uninterrupted(self, action, argument):
        action(argument)

    def unique_id(self):
        return b"0123456789abcdef"

    def boot_id(self):
        return 4711

    def load(self, name):
        return self.files.get(name)

    def store(self, name, data):
        self._change("store", name, self._store, data)

    def rename(self, old, new):
        self._change("rename", old, self._rename, new)

    def remove(self, name):
        self._change("remove", name, self.files.pop)

    def _store(self, name, data):
        self.files[name] = bytes(data)

    def _rename(self, old, new):
        self.files[new] = self.files.pop(old)

    def _change(self, what, name, action, *arguments):
        self.us += 45_000  # about a flash sector's erase
        self.unlock()
        try:
            if self.full:
                raise OSError(28)
            if what != "store" and name not in self.files:
                raise OSError(2)
            action(name, *arguments)
            self.file_log.append((self.us - START_US, what, name))
        finally:
            self.lock()

    def firmware_hash(self):
        self.unlock()  # file work, at rest
        for part in (None, None, None, b"5a" * 32):
            self.lock()
            if self.full:
                raise OSError(5)
            yield part
            self.unlock()

    def reset_cause(self):
        return 1

    def collect(self):
        pass

    def free_memory(self):
        return 100_000

    def output(self, number, pwm_hz=0):
        return Output(self, number, pwm_hz)

    def encoder(self, number, pins):
        return None  # rig_encoder.py has a port with encoders

    def on_rise(self, number, handler):
        self.handlers[number] = handler

    def instant(self):
        """Something happens outside between two steps of the firmware, if a test has said so."""
        if self.instants >= 0:
            self.instants -= 1
            if self.instants < 0:
                self.switches[self.opens] = 1
                self.unlock()
                self.handlers[self.opens](None)
                self.lock()

    def start_watchdog(self):
        self.feed()
        return self.feed

    def stop_watchdog(self):
        self.fed_at = None

    def feed(self):
        self.fed_at = self.us

    def reader(self, number):
        if number is None:
            return None

        def read():
            self.us += 1
            return self.switches.get(number, 1)

        return read


class Output:
    def __init__(self, port, number, pwm_hz):
        self._port = port
        self._number = number
        self.shows = 0
        if pwm_hz:
            self.set_hz(pwm_hz)
        self._set(0)

    def _set(self, duty):
        port = self._port
        port.us += 2
        port.instant()
        if port.pins.get(self._number) != duty:
            port.unlock()
            port.pins[self._number] = duty
            port.edges.append((port.us - START_US, self._number, duty))
            port.lock()
        port.instant()

    def low(self):
        self._set(0)
        self.shows = 0

    def high(self):
        self._set(65535)
        self.shows = 1

    def level(self, duty_u16):
        assert self._number in self._port.hz, "this output has no PWM"
        assert 0 <= duty_u16 <= 65535
        self._set(duty_u16)
        self.shows = 2

    def set_hz(self, hz):
        self._port.unlock()
        self._port.hz[self._number] = hz
        self._port.lock()


class Rig:
    """An app on such a port. send() now or later, run(), then look."""

    def __init__(self, board=None, files=None, port=None):
        self.board = board or Board()
        self.port = port or Port(files)
        self.app = build.build(self.port, self.board)
        self.controller = self.app.controller
        self.axes = self.controller.axes
        self.axis1, self.axis2 = self.axes[:2]
        self.queries = self.app.queries
        self.line = self.app._commands._line
        self.about = self.queries.about

    def now(self):
        """Microseconds since the start."""
        return self.port.us - START_US

    def send(self, data, after_us=0, gap_us=0):
        """Schedule bytes: the first after_us from now, gap_us between two."""
        t = self.port.us + after_us
        for c in data:
            self.port.inbox.append((t, c))
            t += gap_us

    def run(self, us):
        """Let the loop run for us microseconds (and to the end of the pass)."""
        until = self.port.us + us
        self.port.horizon_us = until
        while self.port.us < until:
            self.step()

    def step(self):
        """One pass of the loop; under heap_lock if port.locked."""
        if not self.port.locked:
            self.app.run_once()
            return
        heap_lock()
        try:
            self.app.run_once()
        finally:
            heap_unlock()

    def settle(self):
        """Let the loop take in all that was sent, and answer."""
        self.take_in()
        self.run(20_000)

    def take_in(self):
        """Let the loop run until it has read the last byte that was sent."""
        self.port.horizon_us = self.port.us + 10_000_000
        while self.port.taken < len(self.port.inbox):
            self.step()
        self.port.inbox.clear()
        self.port.taken = 0

    def ask(self, data):
        """Send, settle, and return what came back since."""
        start = len(self.port.sent)
        self.send(data)
        self.settle()
        return bytes(self.port.sent[start:])

    def drives(self):
        """The drive of each motor, -255 ... 255, read from the pins."""
        return tuple([self._drive(pins) for pins in boards.axes(self.board)])

    def _drive(self, pins):
        level = self.port.pins
        pos = level[pins["pos"]]
        neg = level[pins["neg"]]
        if pins["en"] is None:
            return (pos - neg) // 257
        if level[pins["en"]] == 65535 and pos != neg:  # full, or slow decay
            return (pos - neg) // 257
        if (pos == 0) == (neg == 0):
            off = level[pins["en"]] == 0 or (pos == 0 and self.port.ENABLE_IS_LATE)
            assert off, "enabled with both legs alike"
            return 0
        return level[pins["en"]] // 257 * (1 if pos else -1)

    def on_times(self, pin):
        """How long pin was not low, each time, in microseconds."""
        times = []
        since = None
        for us, number, duty in self.port.edges:
            if number == pin:
                if duty and since is None:
                    since = us
                elif not duty and since is not None:
                    times.append(us - since)
                    since = None
        return times

    def errors(self):
        """The queued errors' codes, taken from the queue over the wire."""
        codes = []
        while True:
            code = int(self.ask(b"TE?\n"))
            if code == 0:
                return codes
            codes.append(code)
