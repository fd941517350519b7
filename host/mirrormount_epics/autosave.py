"""What a person has set on a record, kept by the board's id for the next start: ioc.toml in the user's folder.

Never a position: the board has it, with its certainty. An offset belongs to a unit and a size of step; with another
one it is not restored.
"""

import logging
import math
from collections.abc import Mapping
from typing import Any

from mirrormount import files
from mirrormount.device import calibration
from mirrormount.errors import MountError
from mirrormount_epics.base import Record
from mirrormount_epics.motor import Motor

KEPT: dict[str, type] = {"DESC": str, "OFF": float, "DIR": int, "FOFF": int, "TWV": float}
_GUARDS = ("EGU", "MRES")  # what an offset and a tweak belong to
_OF_UNIT = ("OFF", "TWV")
_HEADING = "mirrormount ioc: what was set on the records of each board's axes (docs/control-systems.md)."

_log = logging.getLogger("mirrormount.epics")


class Saved:
    """What is kept of one board. A file that cannot be read is told, left alone, and nothing is restored."""

    def __init__(self, board_id: str) -> None:
        self._id = board_id
        self._path = calibration.path().with_name("ioc.toml")

    def restore(self, axis: str, record: Record, motor: Motor) -> None:
        """Set on a record what is kept of its axis. With the record locked."""
        try:
            kept = self._read().get(self._id, {}).get(axis, {})
        except (MountError, AttributeError) as e:
            _log.warning("nothing is restored: %s", e)
            return
        fits = all(kept.get(name) == record[name] for name in _GUARDS)
        values = {
            name: kept[name]
            for name, kind in KEPT.items()
            if _is(kept.get(name), kind) and (fits or name not in _OF_UNIT)
        }
        if not fits and kept.get("OFF"):
            _log.warning("%s: the offset %s is of another unit or step, and is not restored", record.name, kept["OFF"])
        motor.restore(values)

    def keep(self, records: Mapping[str, tuple[Record, Motor]]) -> None:
        """Write down what is on the records, if it differs from what is kept. What nobody has set is not kept."""
        now = {axis: _values(record) for axis, (record, _) in records.items()}
        try:
            tables = self._read()
            if now == tables.get(self._id, now if all(map(_is_as_made, now.values())) else None):
                return
            tables[self._id] = now
            files.write_atomic(self._path, files.toml_text_for(self._path, tables, _HEADING), make_folder=True)
        except MountError as e:
            _log.warning("not kept for the next start: %s", e)

    def _read(self) -> dict[str, Any]:
        return files.read_toml(self._path)


def _values(record: Record) -> dict[str, Any]:
    with record:
        return {name: record[name] for name in (*KEPT, *_GUARDS)}


def _is_as_made(values: Mapping[str, Any]) -> bool:
    return (values["OFF"], values["DIR"], values["FOFF"], values["TWV"]) == (0.0, 0, 0, 1.0)


def _is(value: object, kind: type) -> bool:
    if kind is float:
        return isinstance(value, float) and math.isfinite(value)
    return isinstance(value, kind) and (kind is str or value in (0, 1))
