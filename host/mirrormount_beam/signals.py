"""Sources of a signal that is maximised: a board's analog input, a camera, a power meter, a person's own function.

open_signal("scpi:/dev/ttyUSB1", ...) yields a Source; each read() of it is one reading.
"""

import contextlib
import importlib
import math
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import serial

from mirrormount.device.mount import Mount
from mirrormount.device.table_file import CameraSettings
from mirrormount.errors import BadValue, MountError
from mirrormount.terminal import printable
from mirrormount_beam.camera import Image, grey, to_grey
from mirrormount_beam.cameras import open_camera
from mirrormount_beam.errors import SignalError, SignalSaturated

SCPI_QUERY = "MEAS:POW?"  # of Thorlabs' PM100 and others
BAUD = 9600
SOURCES = "board, camera:NAME, scpi:PORT, serial:PORT, python:MODULE:FUNCTION"
_ANSWER_S = 2.0  # a meter that averages may take a second
_ADC_FULL = 65520  # 4095 of 12 bits, as the boards tell it
_SCPI_INFINITY = 9.9e37  # and more: no number (SCPI-99, 7.2.1.4)
_SATURATED = 1e-3  # of a region's pixels: more than hot pixels
_LEVEL = 20.0  # percentile of a region that counts as dark: a fibre's end fills less than the rest of it
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf)\w*)", re.IGNORECASE)


@dataclass(frozen=True)
class Source:
    """read: one reading; raises SignalError, MountError. full_scale: what it returns at the end of its range."""

    name: str
    read: Callable[[], float]
    full_scale: float = math.inf


@contextlib.contextmanager
def open_signal(
    text: str,
    ask_board: Callable[[str, Callable[[Mount], int]], int],
    settings: CameraSettings,
    query: str | None = None,
    baud: int = BAUD,
) -> Iterator[Source]:
    """Open a source by its name: one of SOURCES.

    ask_board(name, question): asks the mount of that name ("": the first one). query: of a meter; None: SCPI_QUERY, or
    for serial: the meter sends lines by itself. Raises BadValue, SignalError, CameraError.
    """
    kind, _, rest = text.partition(":")
    if query is not None and kind not in ("scpi", "serial"):
        raise BadValue("--query is a meter's: --signal scpi:PORT or serial:PORT")
    if kind == "board":
        yield Source(text, lambda: float(ask_board(rest, Mount.power)), _ADC_FULL)
    elif kind == "camera" and rest:
        with contextlib.closing(open_camera(rest, settings=settings)) as camera:
            frames = (frame for frame in camera.frames() if not frame.repeated)
            yield Source(text, lambda: light_of(next(frames)))
    elif kind in ("scpi", "serial") and rest:
        with contextlib.closing(_Meter(rest, query or (SCPI_QUERY if kind == "scpi" else ""), baud)) as meter:
            yield Source(text, meter.read)
    elif kind == "python" and rest.count(":") == 1:
        yield Source(text, _function(*rest.split(":")))
    else:
        raise BadValue(f"--signal is one of {SOURCES}, not {printable(text)!r}")


def light_of(image: Image) -> float:
    """The sum of the region's grey values above its dark level. Raises SignalSaturated."""
    rows, columns, _ = image.selection.part(image.image.shape)
    region = grey(to_grey(image.image[rows, columns]))
    if region.saturated.mean() > _SATURATED:
        raise SignalSaturated(f"{region.saturated.mean():.0%} of the camera's region is saturated")
    ordered = region.image.reshape(-1)
    rank = int(_LEVEL / 100 * ordered.size)
    return float(ordered.sum(dtype=np.float64) - float(np.partition(ordered, rank)[rank]) * ordered.size)


class _Meter:
    """A power meter at a serial port."""

    def __init__(self, port: str, query: str, baud: int) -> None:
        self._query = query
        try:
            self._serial = serial.serial_for_url(port, baudrate=baud, timeout=_ANSWER_S, write_timeout=_ANSWER_S)
        except (serial.SerialException, OSError, ValueError) as e:
            raise SignalError(f"{printable(port)} cannot be opened: {getattr(e, 'strerror', None) or e}") from e
        self.name = port

    def read(self) -> float:
        """The newest number. Raises SignalError."""
        try:
            self._serial.reset_input_buffer()
            if self._query:
                self._serial.write(self._query.encode("ascii") + b"\n")
            else:
                self._line()  # the rest of a line that had begun
            line = self._line()
        except (serial.SerialException, OSError) as e:
            raise SignalError(f"{printable(self.name)}: the meter is gone: {getattr(e, 'strerror', None) or e}") from e
        text = line.decode("ascii", "replace").strip()
        if not (found := _NUMBER.match(text)):
            raise SignalError(f"{printable(self.name)}: the meter said {printable(text[:40])!r}, no number")
        value = float(found[1])
        return value if abs(value) < _SCPI_INFINITY else math.nan

    def _line(self) -> bytes:
        line = self._serial.readline()
        if not line.endswith((b"\n", b"\r")):
            asked = f" to {self._query}" if self._query else ""
            raise SignalError(f"{printable(self.name)}: no answer{asked} within {_ANSWER_S:g} s")
        return line

    def close(self) -> None:
        """Close the port."""
        self._serial.close()


def _function(module: str, name: str) -> Callable[[], float]:
    """A function of the person's own, which their own command line names. Raises BadValue."""
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        made = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as e:
        raise BadValue(f"--signal python:{module}:{name}: {e}") from e

    def read() -> float:
        try:
            return float(made())
        except MountError:
            raise
        except Exception as e:
            raise SignalError(f"{module}.{name}() failed: {type(e).__name__}: {e}") from e

    return read
