"""The board's side of the one seam to the simulation: time, pins and bytes. Runs on CPython and MicroPython.

Fixed 16-byte records "<BBHIQ": kind, a, b, dt, t.
    to the simulation    E pin a has duty b at t, by a PWM of dt Hz (0: none)      T byte a was sent at t
                    S at t the firmware waits, until t + dt unless something happens, b bytes unread: then it blocks
    from the simulation  R byte a was received        P pin a has level b
                    W the host collects (a = 1) or not (0)
                    D a program has the port open (a = 1) or not (0)
                    N a change of pin a's duty ends the granted time
                    Q input a has level b from t on, unless something is said again; a - 64 is the SDA of a bus
                      whose angle is b
                    G go on: it is t, and you may run to t + dt before you ask again
Time is absolute microseconds here; the wrap at 2**30 is applied where the firmware reads a clock.
"""

import struct

import micropython

WRAP_MASK = (1 << 30) - 1
RECORD = "<BBHIQ"
RECORD_SIZE = 16
EDGE, SENT, WAIT = 69, 84, 83
RECEIVED, PIN, COLLECTS, OPEN, GO = 82, 80, 87, 68, 71
ENDS, CHANGE = 78, 81


class Seam:
    """rd.readinto() must fill a record; wr.write() must take one. t0 is the time at power-up."""

    def __init__(self, rd, wr, t0):
        self._rd = rd
        self._wr = wr
        self.t = t0
        self._grant = t0  # may run to here without asking
        self._out = bytearray(RECORD_SIZE)
        self._in = bytearray(RECORD_SIZE)
        self._rx = bytearray(1024)
        self._head = 0
        self._tail = 0
        self.collects = True
        self.opened = True
        self.latched = []  # (when, pin, duty, hz): what a PWM will show when its period is over
        self.levels = {}  # of input pins that something drives
        self.handlers = {}  # of input pins: what to call when they rise
        self.coming = []  # (when, input, level): what will change, while no drive does
        self.counters = {}  # of inputs: what to call with (input, level) when they change
        self._ends = set()
        self.interrupt_char = 3
        self._interrupted = False
        self._risen = []  # interrupts that are to be served
        self._off = False  # the simulation is gone: no reader any more
        self.locks = 0  # how deep the firmware has locked the heap

    def tick(self, us):
        """Something that costs us microseconds was done."""
        self.t += us
        if self.latched:
            self._show_latched()
        if self.coming:
            self._show_coming()
        if self.t >= self._grant:
            self.wait(self.t)

    def wait(self, until):
        """Let the simulation go on; back at `until`, or earlier when something has happened."""
        if self._off:
            raise SystemExit(0)
        if self.latched and self.latched[0][0] < until:
            until = self.latched[0][0]
        locks = self._unlock()
        try:
            self.coming = []
            self._send(WAIT, 0, self.waiting(), until - self.t)
            while self._take_record():
                pass
        finally:
            self._lock(locks)
        self._show_latched()
        if self.coming:
            self._show_coming()
        while self._risen:
            self._risen.pop(0)()
        if self._interrupted:
            self._interrupted = False
            raise KeyboardInterrupt

    def edge(self, pin, duty, hz=0):
        """Pin `pin` has duty 0 ... 65535 from now on, by a PWM of hz."""
        if pin in self._ends:
            self._grant = self.t
        self._record(EDGE, pin, duty, hz)

    def latch(self, t, pin, duty, hz):
        """The same from t on, unless something else is latched for that pin before."""
        locks = self._unlock()
        self.latched = sorted(self._latched_elsewhere(pin) + [(t, pin, duty, hz)])
        self._lock(locks)

    def unlatch(self, pin):
        """Drop the latched level of a pin."""
        if self.latched:
            locks = self._unlock()
            self.latched = self._latched_elsewhere(pin)
            self._lock(locks)

    def _latched_elsewhere(self, pin):  # with the heap unlocked: a name that a comprehension shares is allocated
        return [item for item in self.latched if item[1] != pin]

    def _show_latched(self):
        now = self.t
        while self.latched and self.latched[0][0] <= now:
            self.t, pin, duty, hz = self.latched.pop(0)
            self.edge(pin, duty, hz)
        self.t = now

    def _show_coming(self):
        locks = self._unlock()
        while self.coming and self.coming[0][0] <= self.t:
            at = self.coming[0][0]
            changes = []
            while self.coming and self.coming[0][0] == at:  # at once: no counter sees one before the other
                changes.append(self.coming.pop(0)[1:])
            self.levels.update(changes)
            for number, level in changes:
                if number in self.counters:
                    self.counters[number](number, level)
        self._lock(locks)

    def sent(self, c):
        """Send byte c to the host."""
        self._record(SENT, c, 0)

    def forget(self):
        """Drop received bytes that are not read yet."""
        self._tail = self._head

    def waiting(self):
        """How many bytes wait."""
        return (self._head - self._tail) % len(self._rx)

    def received(self):
        """True if a byte waits."""
        return self._head != self._tail

    def take(self):
        """The next received byte; blocks until there is one."""
        while self._head == self._tail:
            self.wait(self.t + 1_000_000)
        c = self._rx[self._tail]
        self._tail = (self._tail + 1) % len(self._rx)
        return c

    def _record(self, kind, a, b, dt=0):
        locks = self._unlock()
        try:
            self._send(kind, a, b, dt)
        finally:
            self._lock(locks)

    def _send(self, kind, a, b, dt):
        if self._off:
            return
        struct.pack_into(RECORD, self._out, 0, kind, a, b, dt, self.t)
        try:
            self._wr.write(self._out)
        except OSError:
            self._off = True

    def _take_record(self):
        if not self._rd.readinto(self._in):
            self._off = True
            raise SystemExit(0)
        kind, a, b, dt, t = struct.unpack(RECORD, self._in)
        if kind == GO:
            self.t = t
            self._grant = t + dt
            return False
        if kind == RECEIVED:
            if a == self.interrupt_char:
                self._interrupted = True
            else:
                self._rx[self._head] = a
                self._head = (self._head + 1) % len(self._rx)
        elif kind == PIN:
            rises = b and not self.levels.get(a, 1)
            self.levels[a] = b
            if rises and a in self.handlers:
                self._risen.append(self.handlers[a])
        elif kind == CHANGE:
            self.coming.append((t, a, b))
        elif kind == ENDS:
            self._ends.add(a)
        elif kind == COLLECTS:
            self.collects = bool(a)
        elif kind == OPEN:
            self.opened = bool(a)
        return True

    # the fakes may allocate, the firmware under heap_lock may not

    def _unlock(self):
        locks = self.locks
        for _ in range(locks):
            micropython.heap_unlock()
        return locks

    def _lock(self, locks):
        for _ in range(locks):
            micropython.heap_lock()


seam = None  # set by the boot script before anything else of the board is imported
