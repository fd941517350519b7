"""The cameras of a table, and the loop that holds its beam, as records.

A thread of each camera looks for the spot (LiveCamera); the loop looks in the same images. It runs in a thread while
.HOLD is 1, as a client of each mount of its own: EPICS gives its control up to it, so motor records are at Stop then.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from mirrormount.device import calibration
from mirrormount.device.table_file import CameraEntry
from mirrormount.errors import MountError, NoAnswer, NotCalibrated
from mirrormount_beam import scale
from mirrormount_beam.camera import Camera
from mirrormount_beam.control import events
from mirrormount_beam.control.calibrate import check_controllable
from mirrormount_beam.control.hold import Hold
from mirrormount_beam.control.response import load, save
from mirrormount_beam.errors import CameraGone
from mirrormount_beam.live import LiveCamera
from mirrormount_beam.spot.find import Spot
from mirrormount_beam.table import SharedTable, TargetCamera
from mirrormount_epics import base, fields
from mirrormount_epics.fields import CAMERA_STATES, LOOP_STATES
from mirrormount_epics.motor import INVALID, MAJOR, NO_ALARM, STATE
from mirrormount_epics.mount import Board
from mirrormount_epics.pump import Pump

_NO_PICTURE, _NO_SPOT, _SPOT = range(len(CAMERA_STATES))
_MINOR, _UDF = 1, 17  # EPICS's severity and alarm status (menuAlarmSevr, menuAlarmStat)
_ALARM = {events.WAITING: (STATE, _MINOR), events.STOPPED: (STATE, MAJOR)}
_NUMBERS = ("X", "Y", "SX", "SY", "W", "H", "SHAPE")
_CONTROL_S = 3.0  # the time in which EPICS's control of a mount has ended
_END_S = 5.0  # the time in which the loop has ended

_log = logging.getLogger("mirrormount.epics")


class CameraRecord:
    """The record of a camera: the spot in its newest image, or why there is none; the numbers are nan then."""

    def __init__(self, record: base.Record) -> None:
        self.record = record
        self._shown: tuple[int, str] | None = None  # an image, and what is the matter with the camera

    def before(self, field: str) -> None:
        """Nobody puts a field."""

    def put(self, field: str) -> bool:
        """Nobody does."""
        return False

    def process(self) -> None:
        """Its alarm is that of what it shows."""
        self.record.settle(*((NO_ALARM, 0) if self.record["VAL"] == _SPOT else (_UDF, INVALID)))
        self.record.done()

    def show(self, live: LiveCamera) -> None:
        """Tell what is new, with the time of the exposure. The pump's thread."""
        seen, trouble = live.last, live.trouble
        shown = seen.number if seen else 0, trouble
        if shown == self._shown:
            return
        self._shown = shown
        at_s, numbers = time.time(), [math.nan] * len(_NUMBERS)
        state, message = _NO_PICTURE, trouble
        if seen and not trouble:
            at_s -= time.monotonic() - seen.at_s
            state, message = _NO_SPOT, str(seen.found)
            if isinstance(spot := seen.found, Spot):
                state, message = _SPOT, ""
                numbers = [spot.x, spot.y, spot.sigma_x, spot.sigma_y, spot.width, spot.height, spot.shape_px]
        values = {"VAL": state, "MSG": message, **dict(zip(_NUMBERS, numbers, strict=True))}
        with self.record:
            changed = [field for field, value in values.items() if self.record[field] != value]
            for field in changed:
                self.record[field] = values[field]
            self.record.stamp_at(at_s)
            self.process()  # the alarm first: no number is told without it
            for field in changed:
                self.record.post(field)


class LoopRecord:
    """The record of the loop."""

    def __init__(self, record: base.Record) -> None:
        self.record = record
        self._attached = False
        self._hold: Hold | None = None
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()

    def attach(
        self,
        pump: Pump,
        mounts: Mapping[str, tuple[Board, tuple[str, str]]],
        targets: Callable[[], list[TargetCamera]],
    ) -> None:
        """What it drives, and what it looks at; a put before fails.

        mounts: in the order of the beam, with their boards and axes there. targets: makes the cameras as the loop needs
        them, when it begins; raises MountError.
        """
        self._pump, self._mounts, self._targets = pump, mounts, targets
        self._attached = True

    def close(self) -> None:
        """End the loop; motors are off then."""
        self._end()
        if self._thread:
            self._thread.join(_END_S)

    # ---- EPICS's threads

    def before(self, field: str) -> None:
        """Nothing to keep."""

    def put(self, field: str) -> bool:
        """HOLD begins or ends the loop, GO tells one that stands still to go on. False: there is none."""
        hold, running = self._hold, self._thread is not None and self._thread.is_alive()
        if field == "GO":
            self.record["GO"] = 0
            if hold is None:
                return False
            hold.go_on()
        elif not self._attached:  # the IOC is not ready yet
            self.record["HOLD"] = 0
            return False
        elif not self.record["HOLD"]:
            self._end()
        elif not running:
            self._ending.clear()
            self._thread = threading.Thread(target=self._run, name="loop", daemon=True)
            self._thread.start()
        elif self._ending.is_set():  # the one before has not ended yet
            self.record["HOLD"] = 0
            return False
        return True

    def process(self) -> None:
        """Nothing is waited for: .VAL tells how it goes."""
        self.record.settle(*_ALARM.get(LOOP_STATES[self.record["VAL"]], (NO_ALARM, 0)))
        self.record.done()

    def _end(self) -> None:
        self._ending.set()
        if hold := self._hold:
            hold.stop()

    # ---- the loop's thread

    def _run(self) -> None:
        state, why = events.ENDED, ""
        try:
            self._hold_beam()
        except MountError as e:
            state, why = events.STOPPED, str(e)
        except Exception:  # the records of the mounts go on
            _log.exception("the loop has a fault")
            state, why = events.STOPPED, "the loop has a fault: the IOC's log has it"
        self._hold = None
        self._tell(state, why, HOLD=0)

    def _hold_beam(self) -> None:
        """Raises MountError."""
        path = calibration.path().with_name("table-calibration.json")
        mounts = [(name, board.supervisor, axes) for name, (board, axes) in self._mounts.items()]
        with SharedTable("the loop", mounts, self._targets()) as table:
            check_controllable(table)
            response = load(path, table)
            if response is None:
                raise NotCalibrated(f"no calibration yet: end this IOC, and run `mirrormount calibrate` first ({path})")
            hold = self._hold = Hold(table, response, listen=self._listen)
            if self._ending.is_set():
                return
            for board, _ in self._mounts.values():
                _give_up(board)
            table.take_control()
            try:
                hold.run()
            finally:
                save(response, path)  # what it has learned

    def _listen(self, event: events.Event) -> None:
        if isinstance(event, events.StateChanged):
            self._tell(event.state, event.why)
        elif isinstance(event, events.Estimated):
            errors = [abs(um) for pair in event.errors_um.values() for um in pair]
            angle = max(map(abs, event.angle_urad)) if event.angle_urad else math.nan
            self._pump.put(lambda: self._show(ERR=max(errors), ANGLE=angle))

    def _tell(self, state: str, why: str, **values: Any) -> None:
        if state in (events.WAITING, events.STOPPED, events.ENDED):
            values |= {"ERR": math.nan, "ANGLE": math.nan}
        self._pump.put(lambda: self._show(VAL=LOOP_STATES.index(state), WHY=why, **values))

    # ---- the pump's thread

    def _show(self, **values: Any) -> None:
        with self.record:
            self.record.update(**values)
            self.process()


class TableRecords:
    """The records of the cameras, which it watches, and of the loop. Between start_database() and serve().

    cameras: by name, what opens each, and its entry in the table's file. A camera that cannot be opened is an alarm on
    its record, and is tried again.
    """

    def __init__(self, prefix: str, cameras: Mapping[str, tuple[Callable[[], Camera], CameraEntry]]) -> None:
        self._records: dict[str, CameraRecord] = {}  # EPICS makes them in serve()
        self._loop: LoopRecord | None = None
        types = fields.record_types()
        base.RecordType("camera", types["camera"], self._make_camera)
        base.RecordType("loop", types["loop"], self._make_loop)
        names = [*((name, "camera") for name in cameras), (fields.LOOP_NAME, "loop")]
        base.load("".join(fields.linked_records(kind, prefix + name) for name, kind in names))
        self._prefix = prefix
        self._entries = {name: entry for name, (_, entry) in cameras.items()}
        self._live = {name: LiveCamera(name, open_camera) for name, (open_camera, _) in cameras.items()}
        for live in self._live.values():
            live.open(absent=True)

    def _make_camera(self, record: base.Record) -> CameraRecord:
        self._records[record.name] = CameraRecord(record)
        return self._records[record.name]

    def _make_loop(self, record: base.Record) -> LoopRecord:
        self._loop = LoopRecord(record)
        return self._loop

    def attach(self, pump: Pump, mounts: Mapping[str, tuple[Board, tuple[str, str]]]) -> None:
        """Show what the cameras see from now on. mounts: as LoopRecord.attach()."""
        assert self._loop
        self._loop.attach(pump, mounts, self._targets)
        for name, live in self._live.items():
            pump.often.append(partial(self._records[self._prefix + name].show, live))

    def close(self) -> None:
        """End the loop, which switches motors off, and close the cameras."""
        if self._loop:
            self._loop.close()
        for live in self._live.values():
            live.close()

    def _targets(self) -> list[TargetCamera]:
        return [_target(name, live, self._entries[name]) for name, live in self._live.items()]


def _give_up(board: Board) -> None:
    """End EPICS's control of a board, which stops what it moves. Raises NoAnswer."""
    if board.program.in_control:
        board.program.stop()
    end_s = time.monotonic() + _CONTROL_S
    while board.supervisor.worker.lease.holder is board.program:
        if time.monotonic() > end_s:
            raise NoAnswer("the board did not answer to a stop")
        time.sleep(0.01)


def _target(name: str, live: LiveCamera, entry: CameraEntry) -> TargetCamera:
    """A camera as the loop needs it. Raises CameraGone if it shows nothing, NotCalibrated without a scale."""
    if live.trouble:
        raise CameraGone(live.trouble)
    um = 1000 * scale.read(live).mm_per_px
    middle = (live.size.width - 1) / 2, (live.size.height - 1) / 2
    distance_m = None if entry.distance_mm is None else entry.distance_mm / 1000
    return TargetCamera(name, live, entry.target_px or middle, (um, um), distance_m, find=live.found)
