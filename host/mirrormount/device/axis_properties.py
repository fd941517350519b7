"""The settings of an axis as its properties. Imports session, settings.

tools/tables.py writes their list from the declarations of mountfw/settings.py, so that editors and type checkers
know each by its name.
"""

from typing import Generic, Self, TypeVar, cast, overload

from mirrormount.device import settings
from mirrormount.device.session import Session

N = TypeVar("N", int, float)


class Property(Generic[N]):
    """A setting of an axis, read from the board and set on it. Its name is that of the setting.

    Reading raises BoardError, NoAnswer, ConnectionLost; setting also BadValue, SettingRefused.
    """

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, axis: None, owner: type) -> Self: ...
    @overload
    def __get__(self, axis: "AxisProperties", owner: type) -> N: ...
    def __get__(self, axis: "AxisProperties | None", owner: type) -> "Self | N":
        if axis is None:
            return self
        return cast(N, settings.read_one(axis._session, axis.name, self._name))

    def __set__(self, axis: "AxisProperties", value: N) -> None:
        settings.write(axis._session, {axis.name: {self._name: value}})


class AxisProperties:
    """Base of an axis: its session, its name, its settings. They last until the board restarts, unless saved."""

    __slots__ = ("_session", "name")

    def __init__(self, session: Session, name: str) -> None:
        self._session = session
        self.name = name

    # properties: made by tools/tables.py
    inverted = Property[int]()
    """Wiring: 1: the axis runs the other way"""
    switches = Property[int]()
    """Wiring: switches fitted: 1 positive + 2 negative + 4 home"""
    motor_type = Property[int]()
    """Wiring: 3: DC motor connected, 0: none"""
    pulse_us = Property[int]()
    """Pulse and speed: length of a step's pulse, us"""
    step_duty = Property[int]()
    """Pulse and speed: duty of a step, 1 … 255"""
    velocity = Property[float]()
    """Pulse and speed: steps per second"""
    acceleration = Property[int]()
    """Pulse and speed: kept for other programs; pulses do not ramp"""
    run_duty = Property[int]()
    """Pulse and speed: duty of a run, 1 … 255"""
    take_up_us = Property[int]()
    """Take-up: drive that takes up the backlash, us; 0: off"""
    checking = Property[int]()
    """Limits: 1 ignores end-stops + 8 checks soft limits"""
    soft_minimum = Property[int]()
    """Limits: negative soft limit, steps"""
    soft_maximum = Property[int]()
    """Limits: positive soft limit, steps"""
    run_limit_ms = Property[int]()
    """Limits: longest run, ms"""
    search_limit_ms = Property[int]()
    """Limits: longest search for a switch or an end, ms of drive"""
    counts_per_step = Property[int]()
    """Encoder: counts of one step; 0: not measured"""
    closed_loop = Property[int]()
    """Encoder: 1: closed loop, the position is measured; 0: open loop"""
    dead_band = Property[int]()
    """Encoder: counts that a move may end beside its target"""
    correction_s = Property[float]()
    """Encoder: rest before a move's end is judged, s"""
    following_error = Property[int]()
    """Encoder: counts that a step's drive may be wrong by"""
    stall_ms = Property[int]()
    """Encoder: drive without a count that ends a move, ms"""
    stall_duty = Property[int]()
    """Encoder: duty of a search for the end by stall; 0: off"""
    zero_angle = Property[int]()
    """Encoder: an AS5600's angle at position 0, 1 … 4096; 0: none"""
    # end
