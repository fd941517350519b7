"""The loop's side of a port's gate (docs/gate.md): it enters and leaves, and agrees with the parser. Imports codes."""

from mountfw import codes


class Gated:
    """A port's gate, or None, for a controller's drives. about gets what XH? tells of it."""

    def __init__(self, gate, controller, about):
        self._gate = gate
        self._in_place = False
        self._controller = controller
        self._about = about
        self.received = 0  # stops, ever

    def enter(self):
        """Put the gate in place, if it finds all that it needs."""
        if self._gate:
            self._about.gate = self._gate.enter()
            self._in_place = self._about.gate == codes.GATE_IN_PLACE
            if self._in_place:
                for axis in self._controller.axes:
                    axis.drive.gate = self._gate.axes[axis.number - 1]
                    axis.drive.clock = axis.drive.gate.clock

    def leave(self, ticks_us):
        """Out of the way, for good or until enter(). All drives are off. ticks_us: the drives' clock from here on."""
        if self._gate:
            self._in_place = False
            for axis in self._controller.axes:
                axis.drive.gate = None
                axis.drive.clock = ticks_us
            self._gate.leave()

    def released(self):
        """True if nothing holds the drives low. Every stop that was received is parsed, and the drives are off."""
        return not self._in_place or self._gate.release(self.received & 0x3FFFFFFF)

    def watch(self, receiver):
        """Nothing waits: stops that the gate has found and that were not received are lost, by a reset of the bus.

        They end all moves, as if they were received now.
        """
        if self._in_place and not receiver.unparsed and self._gate.differs(self.received & 0x3FFFFFFF):
            self._controller.stop_all(codes.ABORTED)
            if self._gate.recount(self.received & 0x3FFFFFFF, receiver.zeros):
                self._controller.inhibit(codes.NONE_YET)
