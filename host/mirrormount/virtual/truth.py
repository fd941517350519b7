"""A file with the true turns of the screws: one JSON object a line, at each end of a motion."""

import contextlib
import json
from pathlib import Path

from mirrormount.common.errors import BadAddress, CannotWrite
from mirrormount.virtual.bench import Bench


class Truth:
    """{"t_us": microseconds since power-up, "m1_screw_rev": revolutions, "m2_screw_rev": …}. Raises BadAddress."""

    def __init__(self, file: Path, start_us: int) -> None:
        self._start_us = start_us
        try:
            self._file = file.open("w", encoding="utf-8")
        except OSError as e:
            raise BadAddress(f"cannot write the truth to {file}: {e.strerror}") from e

    def watch(self, bench: Bench) -> None:
        """Write down each end of a motion on this bench from now on."""
        bench.on_rest = self._rests

    def _rests(self, us: int, screws: dict[str, float]) -> None:
        line = {"t_us": us - self._start_us} | {f"{motor}_screw_rev": rev for motor, rev in screws.items()}
        try:
            self._file.write(json.dumps(line) + "\n")
            self._file.flush()
        except OSError as e:
            raise CannotWrite(f"cannot write the truth to {self._file.name}: {e.strerror}") from e

    def close(self) -> None:
        """Close the file; a failed write was reported when it happened."""
        with contextlib.suppress(OSError):
            self._file.close()
