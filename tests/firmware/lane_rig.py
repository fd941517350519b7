"""A rig whose port has a fast lane (docs/gate.md): in Python, line for line what ports/rp2_lane.py does in native code.

Runs under CPython and under MicroPython.
"""

from gate_rig import GatedPort
from rig import Port, Rig

from mountfw.ports.lane import Lane
from mountfw.wire import frame
from mountfw.wire.ticks import diff

WAITING, FIRST, EACH = 0, 4, 3  # places in a Lane's log


def speed_of(packed, which):
    n = packed >> (0 if which else 10)
    return -(n & 0xFF) if n & 0x200 else n & 0xFF


class LaneInput(Lane):
    """As rp2_lane.lane, on a rig's port."""

    def __init__(self, port, *parts):
        super().__init__(*parts)
        self.port = port
        self.taken = 0  # frames, ever

    def read(self, most, wait_ms):
        lane = self
        port = self.port
        receiver = self.receiver
        came = waits = port.any(max(0, wait_ms))
        since = port.ticks_us()
        if not came and wait_ms < 0:
            return -1
        if wait_ms >= 0:
            lane.woke_at = since
            if not came and receiver.unparsed < 8:
                return -1
        left_us = 0
        stop = 0
        while True:
            while most and receiver.unparsed <= receiver.mask and not stop:
                if not waits:
                    soon = left_us and not receiver.unparsed and diff(port.ticks_us(), since) < left_us
                    waits = port.any(2 if soon else 0)
                    if not waits:
                        break
                waits = False
                came = True  # native: at != began
                port.us += 20
                c = port.inbox[port.taken][1]
                port.taken += 1
                most -= 1
                stop = receiver.receive(c)
                receiver.received_at = port.ticks_us()
                if stop:
                    for axis in lane.axes:
                        axis.drive.bridge.cut()
            if stop or receiver.unparsed < 8 or wait_ms < 0:
                break
            at = receiver.write - receiver.unparsed
            if not self.obeyed(at):
                break
            receiver.unparsed -= 8
            receiver.ahead = 0
            came = True
            left_us = left_us or (lane.linger() if lane.last else 1)
            most += 8
        return stop if came else -1

    def obeyed(self, at):
        lane = self
        receiver = self.receiver
        packed = frame.pack(receiver.ring, at, receiver.mask)
        log = lane.log
        n = log[WAITING]
        if packed < 0 or not packed & 0x3FCFF or n == (len(log) - FIRST) // EACH:
            return False
        drive = lane.axes[0].drive
        if n == 0:
            if drive.inhibited or drive.on_flash or drive.watched or lane.axes[1].drive.watched:
                return False
            if receiver.state or lane.commands.busy:
                return False
        if drive.emergency:
            return False
        place = FIRST + EACH * n
        log[place] = packed
        for which in range(2):  # off goes first
            log[place + 1 + which] = 0
            was = log[place - EACH] >> (0 if which else 10) & 0xFF if n else lane.axes[which].state
            if not speed_of(packed, which) and was:
                lane.axes[which].drive.bridge.cut()
                log[place + 1 + which] = self.port.ticks_us()
        for which in range(2):
            speed = speed_of(packed, which)
            if speed:
                driven = lane.axes[which].drive
                log[place + 1 + which] = driven.bridge.drive(-speed if driven.inverted else speed)
        if drive.emergency:
            for axis in lane.axes:
                axis.drive.bridge.cut()
        log[WAITING] = n + 1
        self.taken += 1
        return True


class LanePort(Port):
    def lane(self, controller, receiver, frame, replies, commands, board):
        self.looks = LaneInput(self, controller, receiver, frame, replies, commands)
        return self.looks


class LaneAndGatePort(GatedPort):
    lane = LanePort.lane


class LaneRig(Rig):
    """A rig with a fast lane; gated: with a gate, too, and it is in place."""

    def __init__(self, board=None, gated=False, port=None):
        super().__init__(board, port=port or (LaneAndGatePort() if gated else LanePort()))
        self.looks = self.port.looks
        self.gate = None
        if gated:
            self.gate = self.port.fitted
            self.app.gated.enter()

    def take_in(self):
        super().take_in()
        if self.gate:
            self.gate.run()
            self.gate.looked = 0
