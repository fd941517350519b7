"""One axis as a motor record: what each of its fields does. Pure: it knows no EPICS, and of a mount only what it asks.

EPICS calls before(), put() and process(), with the record locked. The pump calls the rest, locked as well: show() for
each status of the board, ended() for each outcome, and lost() when control has ended.

A put that is refused fails, and the alarm is STATE, MAJOR, until the next order is accepted; so it is for a motion that
ended early. While the board is not there it is COMM, INVALID. A stop by anybody else latches .SPMG to Stop: nothing
moves then before somebody sets it to Go.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from mirrormount.errors import MountError
from mountfw import codes as wire

STOP, PAUSE, MOVE, GO = range(4)  # .SPMG
NO_ALARM, STATE, COMM = 0, 7, 9  # EPICS's alarm status (menuAlarmStat)
MAJOR, INVALID = 2, 3  # and severity (menuAlarmSevr)
TARGETS = ("VAL", "DVAL", "RVAL", "RLV", "TWF", "TWR")
_STOPPED = (wire.STOPPED, wire.ABORTED, wire.SUPERSEDED)
_FAULTS = (wire.FAULT, wire.WRONG_WAY, wire.FOLLOWING, wire.ENCODER_LOST)
_HOMED, _MEASURED = 2, 4  # certainties (docs/protocol.md)
_GO_FIRST = "stopped: set .SPMG to Go"


class Record(Protocol):
    """The fields of a record. Used with the record locked."""

    def __getitem__(self, field: str, /) -> Any: ...

    def __setitem__(self, field: str, value: Any, /) -> None:
        """Set a field; nobody is told."""
        ...

    def update(self, **values: Any) -> None:
        """Set fields, and tell those that have changed."""
        ...

    def post(self, field: str) -> None:
        """Tell a field."""
        ...

    def settle(self, status: int, severity: int) -> None:
        """The time is now, and the alarm is this."""
        ...

    def done(self) -> None:
        """What was ordered is over: put-callbacks return."""
        ...


class Drive(Protocol):
    """An axis of a mount. All return at once. What begins a motion returns a token, which ended() has again."""

    @property
    def connected(self) -> bool:
        """Is the board there?"""
        ...

    @property
    def in_control(self) -> bool:
        """Would an order be carried out?"""
        ...

    def take_control(self) -> None:
        """Raises MountError if somebody else has it."""
        ...

    def move_to(self, steps: int) -> object:
        """Go to a position; what is under way is ended for it. Raises MountError."""
        ...

    def jog(self, way: int) -> object:
        """Run in the direction of the board's coordinates, 1 or -1. Raises MountError."""
        ...

    def home(self) -> object:
        """Find the home. Raises MountError."""
        ...

    def define(self, steps: int) -> object:
        """The present position is this one. Raises MountError."""
        ...

    def halt(self) -> None:
        """End what is under way, also if somebody else has control. Never raises."""
        ...

    def limit(self, low: int, high: int) -> None:
        """Set the board's soft limits. Raises MountError; a refusal by the board comes as fault()."""
        ...

    def velocity(self, steps_per_s: float) -> None:
        """Set the board's velocity. Raises as limit()."""
        ...


@dataclass(frozen=True)
class Axis:
    """State of an axis in the board's coordinates, as the board tells it. limits: bit 0 positive, 1 negative."""

    position: float
    moving: bool
    direction: int
    limits: int
    reason: int
    certainty: int


@dataclass(frozen=True)
class Setup:
    """What the board's settings say. per_step: EGU of one step. Speeds in steps per second, limits in steps."""

    egu: str = "steps"
    per_step: float = 1.0
    velocity: float = 1.0
    fastest: float = 1.0
    take_up_s: float = 0.0
    low: int = -999_999
    high: int = 999_999


class Motor:
    """Semantics of one motor record. name: of the record."""

    def __init__(self, name: str, record: Record) -> None:
        self.name = name
        self.record = record
        self.drive: Drive | None = None
        self._under_way: object = None  # the token of the motion
        self._aimless = False  # its target is where it ends: a jog, homing, one that was stopped
        self._external = False  # somebody else moves the axis
        self._waiting: int | None = None  # the target of a pause, in steps
        self._error = ""
        self._told_val = 0.0
        self._before: dict[str, Any] = {}

    # ---- called by EPICS

    def before(self, field: str) -> None:
        """A put of this field comes."""
        record = self.record
        self._before = {name: record[name] for name in ("VAL", "DVAL", "RVAL", "RLV", "TWF", "TWR", field)}

    def put(self, field: str) -> bool:
        """The field has been put. False: it is refused, and the put fails."""
        record, value = self.record, self.record[field]
        if field in TARGETS:
            record.update(DMOV=0)
        try:
            if isinstance(value, float) and not math.isfinite(value):
                raise MountError("not a finite number")
            drive = self._drive()
            if field in TARGETS:
                self._aim(field, drive)
            elif field in _ORDERS:
                _ORDERS[field](self, value, drive)
        except MountError as e:
            record.update(**self._before)
            self._fail(str(e))
            if field in TARGETS and self.idle:
                record.update(DMOV=1)
            return False
        return True

    def process(self) -> None:
        """After each accepted put of an order, and whenever EPICS processes the record."""
        self._settle()
        self._tell_val()
        if self.idle:
            self.record.update(DMOV=1, MIP=0)
            self.record.done()

    # ---- called by the pump

    def attach(self, drive: Drive, axis: Axis, setup: Setup) -> None:
        """The board has come, for the first time or again. It is at rest, and nothing of before goes on."""
        self.drive = drive
        self.configure(setup)
        self.show(axis)
        self._aim_here()
        if axis.reason not in (wire.NONE_YET, wire.DONE, wire.STOPPED):  # who waits for it since before a restart
            self._fail(f"the last motion before this start: {wire.REASONS.get(axis.reason, axis.reason)}")
        self._finish()

    def restore(self, values: Mapping[str, Any]) -> None:
        """What a person had set before: OFF, DIR, FOFF, TWV, DESC."""
        self.record.update(**values)
        self._coordinates_changed()
        self._tell_val()

    def configure(self, setup: Setup) -> None:
        """The board's settings are these."""
        record = self.record
        mres = setup.per_step
        rescaled = (record["MRES"], record["EGU"]) != (mres, setup.egu)
        speed = setup.velocity * mres
        record.update(
            EGU=setup.egu, MRES=mres, ERES=mres, RDBD=mres / 2, SPDB=mres / 2, VELO=speed, VMAX=setup.fastest * mres
        )
        record.update(ACCL=setup.take_up_s, BVEL=speed, HVEL=speed, JVEL=speed, UREV=200 * mres)
        if rescaled:
            record.update(DRBV=record["RRBV"] * mres)
            self._aim_here()
        self._limits(setup.low * mres, setup.high * mres)

    def show(self, axis: Axis) -> None:
        """A status of the board."""
        record = self.record
        if not self._external and axis.moving and self.idle:
            self._external = True
            record.update(DMOV=0)
        dial = axis.position * record["MRES"]
        positive, negative = axis.limits & 1, axis.limits >> 1 & 1
        high, low = (negative, positive) if record["DIR"] else (positive, negative)
        raw = round(axis.position)
        record.update(DRBV=dial, RBV=self._user(dial), RRBV=raw, DIFF=record["DVAL"] - dial, RDIF=record["RVAL"] - raw)
        record.update(HLS=high, LLS=low, RHLS=positive, RLLS=negative, CERT=axis.certainty, WHY=axis.reason)
        if axis.direction:
            up = int(axis.direction > 0)
            record.update(CDIR=up, TDIR=up ^ int(record["DIR"]))
        record.update(MOVN=int(axis.moving), MSTA=_bits(axis, record["CDIR"]))
        if axis.moving and record["SPMG"] == MOVE:
            record.update(SPMG=PAUSE)  # as the motor record does: the one move has begun
        if self._external and not axis.moving:
            self._external = False
            self._aim_here()
            self._finish()

    def ended(self, token: object, reason: int, why: str) -> None:
        """A motion is over. reason: the board's, 0 if it was not begun or its end is not known. why: in words."""
        if token is not self._under_way:
            return  # another has replaced it
        self._under_way = None
        drive = self.drive
        ours = reason in _STOPPED and drive is not None and drive.in_control
        failed = reason != wire.DONE and not ours and not (reason == wire.STOPPED and self._aimless)
        if failed:
            self._waiting = None
        self._error = why if failed else ""
        self.record.update(ESTP=self._error, JOGF=0, JOGR=0)
        if (failed or self._aimless or ours) and self._waiting is None:
            self._aim_here()
        self._finish()

    def lost(self) -> None:
        """Somebody else has stopped the mount, taken control, or the board has gone: nothing goes on by itself."""
        self._waiting = None
        self.record.update(SPMG=STOP)
        if self.idle:
            self._aim_here()
            self._finish()

    def stopped(self) -> None:
        """A client of EPICS has stopped the whole mount: what waits is dropped."""
        self._waiting = None
        self._aimless = self._under_way is not None
        if self.idle:
            self._aim_here()
            self._finish()

    def fault(self, why: str) -> None:
        """A setting was refused."""
        self._fail(why)

    def connected(self) -> None:
        """The board has come or gone."""
        self._settle()

    @property
    def idle(self) -> bool:
        """Nothing is under way, and nothing waits."""
        return self._under_way is None and self._waiting is None and not self._external

    # ---- coordinates

    def _sign(self) -> int:
        return -1 if self.record["DIR"] else 1

    def _user(self, dial: float) -> float:
        return dial * self._sign() + self.record["OFF"]

    def _dial(self, user: float) -> float:
        return (user - self.record["OFF"]) * self._sign()

    def _aim_here(self) -> None:
        """The target is where it stands."""
        self._targets(self.record["DRBV"])
        self._tell_val()

    def _targets(self, dial: float) -> None:
        record = self.record
        user = self._user(dial)
        record["VAL"] = user  # told by _tell_val(), once
        steps = round(dial / record["MRES"])
        record.update(DVAL=dial, RVAL=steps, LVAL=user)
        record.update(DIFF=dial - record["DRBV"], RDIF=steps - record["RRBV"])

    def _tell_val(self) -> None:
        if self.record["VAL"] != self._told_val:
            self._told_val = self.record["VAL"]
            self.record.post("VAL")

    def _limits(self, low: float, high: float) -> None:
        self.record.update(DLLM=low, DHLM=high)
        low, high = sorted((self._user(low), self._user(high)))
        self.record.update(LLM=low, HLM=high)

    # ---- orders

    def _aim(self, field: str, drive: Drive) -> None:
        """A new target. Raises MountError."""
        record, before = self.record, self._before
        value = record[field]
        record.update(RLV=0.0, TWF=0, TWR=0)
        if field in ("TWF", "TWR") and not value:
            return
        user = {
            "VAL": lambda: value,
            "DVAL": lambda: self._user(value),
            "RVAL": lambda: self._user(value * record["MRES"]),
            "RLV": lambda: before["VAL"] + value,
            "TWF": lambda: before["VAL"] + record["TWV"],
            "TWR": lambda: before["VAL"] - record["TWV"],
        }[field]()
        dial = self._dial(user)
        if not math.isfinite(dial):
            raise MountError("not a finite number")
        if record["SET"]:
            self._define(user, drive)
            return
        beyond = not record["DLLM"] <= dial <= record["DHLM"]
        record.update(LVIO=int(beyond))
        if beyond:
            raise MountError(f"beyond the limits, {record['LLM']:g} to {record['HLM']:g}")
        self._may_move(drive)
        steps = round(dial / record["MRES"])
        if record["SPMG"] == PAUSE:
            self._waiting = steps
        elif self._under_way is not None or steps * record["MRES"] != record["DRBV"]:
            self._begin(lambda: drive.move_to(steps))
        self._accept()
        self._targets(dial)

    def _define(self, user: float, drive: Drive) -> None:
        """Where it stands is called this."""
        record = self.record
        if record["FOFF"]:
            self._may_move(drive)
            if self._under_way is not None:
                raise MountError("it moves: stop it first")
            dial = self._dial(user)
            steps = round(dial / record["MRES"])
            self._begin(lambda: drive.define(steps))
            self._targets(steps * record["MRES"])
        else:
            record.update(OFF=user - record["DRBV"] * self._sign())
            self._coordinates_changed()
        self._accept()

    def _coordinates_changed(self) -> None:
        record = self.record
        self._targets(record["DVAL"] if self._under_way is not None or self._waiting is not None else record["DRBV"])
        self._limits(record["DLLM"], record["DHLM"])
        record.update(RBV=self._user(record["DRBV"]))

    def _may_move(self, drive: Drive) -> None:
        if not drive.in_control or self.record["SPMG"] == STOP:
            raise MountError(_GO_FIRST)

    def _begin(self, start: Callable[[], object], *, aimless: bool = False) -> None:
        """Begin a motion. Raises MountError."""
        self._under_way = start()
        self._aimless = aimless
        self._waiting = None
        self.record.update(DMOV=0, MIP=1, JOGF=0, JOGR=0)

    def _stop(self, value: int, drive: Drive) -> None:
        if not value:
            return
        record = self.record
        record.post("STOP")
        record["STOP"] = 0
        record.post("STOP")
        self._halt(drive)

    def _halt(self, drive: Drive) -> None:
        if self._waiting is not None:
            self._waiting = None
            if self._under_way is None:
                self._aim_here()
        self._aimless = self._under_way is not None
        drive.halt()  # also when nothing is known to move: what somebody else has just begun is not seen yet

    def _spmg(self, value: int, drive: Drive) -> None:
        if value == STOP:
            self._halt(drive)
        elif value == PAUSE:
            if self._under_way is not None and not self._aimless:
                self._waiting = round(self.record["DVAL"] / self.record["MRES"])
                drive.halt()
            else:
                self._halt(drive)
        else:
            if not drive.in_control:
                drive.take_control()
            if self._waiting is not None:
                steps = self._waiting
                self._begin(lambda: drive.move_to(steps))
            if self._error:
                self._accept()

    def _jog(self, field: str, value: int, drive: Drive) -> None:
        record = self.record
        if not value:
            if self._under_way is not None and self._aimless:
                drive.halt()
            return
        self._may_go(drive)
        way = (1 if field == "JOGF" else -1) * self._sign()
        self._begin(lambda: drive.jog(way), aimless=True)
        record.update(**{field: 1})
        self._accept()

    def _home(self, value: int, drive: Drive) -> None:
        self.record.update(HOMF=0, HOMR=0)
        if value:
            self._may_go(drive)
            self._begin(drive.home, aimless=True)
            self._accept()

    def _may_go(self, drive: Drive) -> None:
        self._may_move(drive)
        if self.record["SPMG"] == PAUSE:
            raise MountError("paused: set .SPMG to Go")

    def _direction(self, _value: int, _drive: Drive) -> None:
        """As in the motor record: the user coordinates stay, unless the offset is frozen."""
        record = self.record
        if not record["FOFF"]:
            record.update(OFF=self._before["VAL"] - record["DVAL"] * self._sign())
        self._coordinates_changed()

    def _offset(self, _value: float, _drive: Drive) -> None:
        self._coordinates_changed()

    def _limit(self, dial: bool, drive: Drive) -> None:
        record = self.record
        names = ("DLLM", "DHLM") if dial else ("LLM", "HLM")
        low, high = (record[name] for name in names)
        if not low < high:
            raise MountError(f"the low limit, {low:g}, is not below the high one, {high:g}")
        if not dial:
            low, high = sorted((self._dial(low), self._dial(high)))
        mres = record["MRES"]
        drive.limit(math.ceil(low / mres - 1e-9), math.floor(high / mres + 1e-9))
        self._limits(low, high)

    def _velocity(self, value: float, drive: Drive) -> None:
        most = self.record["VMAX"]
        if not 0 < value <= most:
            raise MountError(f"the velocity is more than 0 and at most {most:g}")
        drive.velocity(value / self.record["MRES"])

    def _synchronise(self, value: int, _drive: Drive) -> None:
        self.record.update(SYNC=0)
        if value and self.idle:
            self._aim_here()

    def _switch(self, button: str, field: str, to: int, value: int) -> None:
        self.record.update(**{button: 0})
        if value:
            self.record.update(**{field: to})

    # ---- the end

    def _drive(self) -> Drive:
        if self.drive is None or not self.drive.connected:
            raise MountError("the board is not there")
        return self.drive

    def _accept(self) -> None:
        self._error = ""
        self.record.update(ESTP="")

    def _fail(self, why: str) -> None:
        self._error = why
        self.record.update(ESTP=why)
        self._settle()

    def _finish(self) -> None:
        self._settle()
        if self.idle:
            self.record.update(DMOV=1, MIP=0)
            self.record.done()

    def _settle(self) -> None:
        if self.drive is None or not self.drive.connected:
            self.record.settle(COMM, INVALID)
        elif self._error:
            self.record.settle(STATE, MAJOR)
        else:
            self.record.settle(NO_ALARM, 0)


def _bits(axis: Axis, up: int) -> int:
    """MSTA, as motorRecord's documentation numbers its bits."""
    flags = {
        0: up,
        1: not axis.moving,
        2: axis.limits & 1,
        5: axis.certainty == _MEASURED,
        6: axis.reason == wire.STALLED,
        9: axis.reason in _FAULTS,
        10: axis.moving,
        13: axis.limits & 2,
        14: axis.certainty == _HOMED,
    }
    return sum(1 << bit for bit, value in flags.items() if value)


_ORDERS: dict[str, Callable[[Motor, Any, Drive], None]] = {
    "STOP": Motor._stop,
    "SPMG": Motor._spmg,
    "JOGF": lambda motor, value, drive: motor._jog("JOGF", value, drive),
    "JOGR": lambda motor, value, drive: motor._jog("JOGR", value, drive),
    "HOMF": Motor._home,
    "HOMR": Motor._home,
    "OFF": Motor._offset,
    "DIR": Motor._direction,
    "LLM": lambda motor, _value, drive: motor._limit(False, drive),
    "HLM": lambda motor, _value, drive: motor._limit(False, drive),
    "DLLM": lambda motor, _value, drive: motor._limit(True, drive),
    "DHLM": lambda motor, _value, drive: motor._limit(True, drive),
    "VELO": Motor._velocity,
    "SYNC": Motor._synchronise,
    "SSET": lambda motor, value, _drive: motor._switch("SSET", "SET", 1, value),
    "SUSE": lambda motor, value, _drive: motor._switch("SUSE", "SET", 0, value),
    "FOF": lambda motor, value, _drive: motor._switch("FOF", "FOFF", 1, value),
    "VOF": lambda motor, value, _drive: motor._switch("VOF", "FOFF", 0, value),
}
