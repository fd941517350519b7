"""A rig whose port has a gate (docs/gate.md): it looks at each byte when that arrives, and cuts at that time.

Pins that it forces stay low whatever the firmware writes. Runs under CPython and under MicroPython.
"""

from rig import START_US, WRAP, Output, Port, Rig

from mountfw import board_file, codes

MASK = WRAP - 1
SILENCE_US = 50_000


class AxisGate:
    def __init__(self, gate, pins):
        self._gate = gate
        self._pins = pins
        self.deadline = None
        self.ended_at = None

    def end_at(self, ends_at):
        self.ended()
        now = self._gate.port.us
        self.deadline = now + ((ends_at - now + WRAP // 2) & MASK) - WRAP // 2

    def clock(self):
        gate = self._gate
        gate.port.us += 3
        gate.run()
        at = gate.port.us
        for cut_at in (gate.cut_at, self.ended_at):
            if cut_at is not None and cut_at < at:
                at = cut_at
        return at & MASK

    def ended(self):
        self._gate.run()
        self.deadline = self.ended_at = None
        if self._gate.cut_at is None:
            self.force(False)

    def force(self, forced):
        for pin in self._pins:
            self._gate.port.force(pin, forced)


class Gate:
    """place: what enter() answers. loses: so many bytes are looked at, and never reach the input."""

    def __init__(self, port, pins, place=codes.GATE_IN_PLACE):
        self.port = port
        self.place = place
        self.entered = False
        self.axes = [AxisGate(self, axis) for axis in pins]
        self.stops = self.zeros = self.looked = 0
        self.cut_at = None  # held since
        self.cuts = []  # us since start
        self.packet_at = 0

    def enter(self):
        self.entered = self.place == codes.GATE_IN_PLACE
        return self.place

    def leave(self):
        self.entered = False
        self.cut_at = None
        for axis in self.axes:
            axis.ended()

    def look(self, c):
        """A byte passes."""
        self.packet_at = self.port.us
        self.zeros = self.zeros + 1 if c == 0x30 else 0
        if c == 0x21 or self.zeros == 8:
            self.zeros = 0
            self.stops += 1
            self.cuts.append(self.port.us - START_US)
            if self.cut_at is None:
                self.cut_at = self.port.us
            for axis in self.axes:
                axis.force(True)

    def run(self):
        """Do what was due up to now, at the time at which it was due."""
        if not self.entered:
            return
        port = self.port
        now = port.us
        while True:
            due = [(axis.deadline, axis) for axis in self.axes if axis.deadline is not None and axis.deadline <= now]
            at = min([t for t, _ in due]) if due else now + 1
            landed = port.inbox[self.looked][0] if self.looked < len(port.inbox) else now + 1
            if at > now and landed > now:
                break
            port.us = min(at, landed)
            if landed <= at:
                self.look(port.inbox[self.looked][1])
                self.looked += 1
            for t, axis in due:
                if t == port.us and axis.deadline is not None:
                    axis.deadline = None
                    axis.ended_at = t
                    axis.force(True)
        port.us = now

    def release(self, parsed):
        self.run()
        if self.stops & MASK != parsed:
            return False
        self.cut_at = None
        for axis in self.axes:
            axis.ended()
        return True

    def differs(self, parsed):
        self.run()
        return self.stops & MASK != parsed and self.port.us - self.packet_at > SILENCE_US

    def recount(self, parsed, zeros):
        if self.differs(parsed):
            self.stops = parsed
            self.zeros = zeros
        return self.release(parsed)


class GatedOutput(Output):
    def _set(self, duty):
        self._port.wanted[self._number] = duty
        self._port.instant()
        super()._set(0 if self._number in self._port.forced else duty)


class GatedPort(Port):
    def __init__(self, files=None):
        super().__init__(files)
        self.forced = set()
        self.wanted = {}
        self.fitted = None

    def gate(self, board):
        self.fitted = Gate(self, board_file.gate_pins(board))
        return self.fitted

    def output(self, number, pwm_hz=0):
        return GatedOutput(self, number, pwm_hz)

    def instant(self):
        super().instant()
        if self.fitted:
            self.fitted.run()

    def force(self, pin, forced):
        before = self.pins.get(pin, 0)
        if forced:
            self.forced.add(pin)
        else:
            self.forced.discard(pin)
        after = 0 if forced else self.wanted.get(pin, 0)
        if after != before:
            self.pins[pin] = after
            self.edges.append((self.us - START_US, pin, after))


class GatedRig(Rig):
    """A rig that has entered its gate."""

    def __init__(self, board=None):
        super().__init__(board, port=GatedPort())
        self.gate = self.port.fitted
        self.app.gated.enter()

    def take_in(self):
        super().take_in()
        self.gate.run()
        self.gate.looked = 0
