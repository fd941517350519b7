"""A motor of the pure semantics, with a record and a drive that the test turns: puts in, what clients would see out."""

import math
from typing import Any

from mirrormount.errors import MountError
from mirrormount_epics import fields
from mirrormount_epics.motor import Axis, Motor, Setup
from mountfw import codes as wire

SHOWN = ("DMOV", "MOVN", "SPMG", "LVIO")


class FakeRecord:
    """Fields in a dict. told: what monitors were told, as FIELD=VALUE; dones: how often put-callbacks returned."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {"SEVR": 0, "STAT": 0}
        for field in fields.MOTOR:
            if field.kind in fields.MENUS:
                initial = fields.MENUS[field.kind].index(field.initial or fields.MENUS[field.kind][0])
            elif field.kind[0] in "TO":
                initial = field.initial
            else:
                initial = float(field.initial or 0) if field.numeric else int(field.initial or 0)
            self.values[field.name] = initial
        self.told: list[str] = []
        self.dones = 0

    def __getitem__(self, field: str) -> Any:
        return self.values[field]

    def __setitem__(self, field: str, value: Any) -> None:
        self.values[field] = value

    def post(self, field: str) -> None:
        self.told.append(f"{field}={self.values[field]}")

    def update(self, **values: Any) -> None:
        for field, value in values.items():
            if self.values[field] != value:
                self.values[field] = value
                self.post(field)

    def settle(self, status: int, severity: int) -> None:
        self.update(STAT=status, SEVR=severity)

    def done(self) -> None:
        self.dones += 1


class FakeDrive:
    """An axis that goes as the test says. orders: what it was asked."""

    def __init__(self) -> None:
        self.connected = self.in_control = True
        self.orders: list[tuple] = []
        self.token = 0
        self.goal: float | None = None
        self.jogs = False
        self.position = 0.0

    def take_control(self) -> None:
        self.orders.append(("take control",))
        self.in_control = True

    def _begin(self, *order: Any) -> int:
        self.orders.append(order)
        self.token += 1
        return self.token

    def move_to(self, steps: int) -> int:
        self.goal, self.jogs = steps, False
        return self._begin("move_to", steps)

    def jog(self, way: int) -> int:
        self.goal, self.jogs = way * math.inf, True
        return self._begin("jog", way)

    def home(self) -> int:
        self.goal = 0
        return self._begin("home")

    def define(self, steps: int) -> int:
        self.goal = self.position = steps
        return self._begin("define", steps)

    def halt(self) -> None:
        self.orders.append(("halt",))

    def limit(self, low: int, high: int) -> None:
        self.orders.append(("limit", low, high))

    def velocity(self, steps_per_s: float) -> None:
        if steps_per_s > 100:
            raise MountError("too fast")
        self.orders.append(("velocity", steps_per_s))


class Player:
    """A motor at 0, with limits of a million steps. Its board says nothing by itself."""

    def __init__(self) -> None:
        self.record, self.drive = FakeRecord(), FakeDrive()
        self.motor = Motor("m1:x", self.record)
        self.motor.attach(
            self.drive, self._axis(False), Setup(low=-1_000_000, high=1_000_000, velocity=2.0, fastest=4.0)
        )
        self.told = self.record.told
        self.record.dones = 0

    def put(self, field: str, value: Any) -> bool:
        """As a client's put. False: it fails."""
        self.motor.before(field)
        self.record[field] = value
        if not self.motor.put(field):
            return False
        if field != "VAL":  # EPICS tells a field that was put, but for VAL, which processing tells
            self.record.post(field)
        if next(f for f in fields.MOTOR if f.name == field).access == fields.ACT:
            self.motor.process()
        return True

    def reach(self, position: float) -> None:
        """It moves, and is there now."""
        self.drive.position = position
        self.motor.show(self._axis(True))

    def halted(self, position: float, reason: int = wire.STOPPED) -> None:
        """Its motion has ended there, before it was done; a later one has begun if one was ordered."""
        token = self.drive.token
        self.drive.position = position
        self.motor.show(self._axis(False, reason))
        self.motor.ended(token, reason, f"x: {wire.REASONS[reason]}")

    def superseded(self, position: float) -> None:
        """The motion before the latest has ended there."""
        self.drive.position = position
        self.motor.show(self._axis(False, wire.STOPPED))
        self.motor.ended(self.drive.token - 1, wire.SUPERSEDED, "superseded")

    def finish(self) -> None:
        """It reaches its goal."""
        if self.drive.orders[-1][0] != "define":
            self.reach(self.drive.position)
        self.drive.position = self.drive.goal
        self.motor.show(self._axis(False, wire.DONE))
        self.motor.ended(self.drive.token, wire.DONE, "")

    def go(self, field: str, value: Any) -> bool:
        """A put, and the motion to its end."""
        token = self.drive.token
        accepted = self.put(field, value)
        if self.drive.token != token:
            self.finish()
        return accepted

    def order(self) -> str:
        """What monitors were told of SHOWN since the last call, each change once."""
        seen: list[str] = []
        for told in self.told:
            if told.split("=")[0] in SHOWN and told not in seen[-1:]:
                seen.append(told)
        self.told.clear()
        return " ".join(seen)

    def _axis(self, moving: bool, reason: int = wire.DONE) -> Axis:
        return Axis(self.drive.position, moving, int(moving), 0, reason, 1)
