"""The virtual table's two boards and its beam in lockstep, with eyes that need no pictures. Its loop can die."""

from fast_table import FastCamera
from loop_rig import Rig

from mirrormount.device.mount import Mount
from mirrormount.errors import ConnectionLost
from mirrormount.transport.link import Link
from mirrormount_beam.control.response import belongs_to
from mirrormount_beam.table import LocalTable
from mirrormount_sim.profiles import PROFILES
from mirrormount_sim.table import Kind, VirtualTable


class Died(BaseException):
    """The loop's process was killed: nothing that it would still do reaches a board."""


class MortalPort:
    """A port of a board. heard_s: when the board was last sent something. pulled: its cable, while it keeps power."""

    def __init__(self, port, table):
        self._port, self.table = port, table
        self.heard_s = 0.0
        self.pulled = False

    def __getattr__(self, name):
        return getattr(self._port, name)

    def write(self, data):
        table = self.table
        if table.dead:
            return
        if table.at_moment and (table.moving() or not table.only_moving):
            table.left -= 1
            if table.left == 0:
                table.at_moment(self, data)
                if table.dead:
                    raise Died
        self._check()
        self.heard_s = self._port.monotonic()
        self._port.write(data)

    def read(self, timeout_s):
        self._check()
        return self._port.read(timeout_s)

    def _check(self):
        if self.pulled:
            raise ConnectionLost("the cable was pulled")

    def send(self, data):
        """What a killed process had sent of its last message."""
        self.heard_s = self._port.monotonic()
        self._port.write(data)


class BoardTable(LocalTable):
    """Use `with`. The mounts have settings of their own, which no loop wants. response: what was calibrated and saved.

    dead: nothing is sent any more.
    """

    OWN = {axis: {"take_up_us": 60_000, "velocity": 1.5} for axis in ("x", "y")}  # noqa: RUF012

    def __init__(self, profile="smooth", seed=1, *, exchanged=False):
        self.virtual = VirtualTable(Kind(profile=PROFILES[profile], seed=seed))
        self.truth = self.virtual.truth
        calibrated = Rig(profile, seed)
        self.noise = calibrated.table.noise
        self.response = calibrated.response  # of the same mechanics, beam and noise
        self._exchanged = exchanged
        self.start()
        for mount in self.mounts:
            mount.apply(self.OWN)
        self.response.belongs = belongs_to(self)

    def start(self):
        """A new process opens the boards."""
        self.dead, self.left, self.at_moment, self.only_moving = False, 0, None, False
        self.sent = [MortalPort(port, self) for port in self.virtual.ports]
        self.mounts = [Mount(Link(port)) for port in self.sent]
        mounts = dict(zip(("first", "second"), self.mounts[:: -1 if self._exchanged else 1], strict=True))
        eyes = [FastCamera(self, number, 0.0, (319.5, 239.5)) for number in (0, 1)]
        super().__init__(mounts, eyes, self.virtual.now_s, self.virtual.sleep)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.virtual.close()

    def spots_mm(self):
        return self.truth.spots_mm(self.now_s())

    def be_off(self, um):
        """Move the targets: the far camera shows an error of so much."""
        for eye, spot, part in zip(self.cameras, self.spots_mm(), (0.45, 1.0), strict=True):
            x, y = eye.px((spot[0], spot[1]))
            eye.target_px = x - part * um / eye.um_per_px[0], y + part * um / 2 / eye.um_per_px[1]

    def at(self, n, action, *, only_moving=False):
        """action(port, data) at the n-th message from now to any board; only_moving: of those while a motor is on."""
        self.left, self.at_moment, self.only_moving = n, action, only_moving

    def moving(self):
        """True while a motor is on."""
        return any(None in interval for number in (0, 1) for interval in self.on(number))

    def on(self, number):
        """When motors of a board were on, by its pins: (from, to) in seconds; to is None where one still is."""
        begun, found = {}, []
        for us, pin, duty in self.virtual.simulations[number].edges:
            if pin.endswith("_en"):
                if duty:
                    begun.setdefault(pin, us * 1e-6)
                elif pin in begun:
                    found.append((begun.pop(pin), us * 1e-6))
        return found + [(from_s, None) for from_s in begun.values()]
