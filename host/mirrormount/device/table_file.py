"""`table.toml`, the names of an optical table, and the way from a name to a port.

The file has the table's mounts and its cameras with their targets; the user may edit it. It is table.toml in the user's
folder for settings, or the one that $MIRRORMOUNT_TABLE names (`--table FILE`):

    [mounts.first]
    board = "e6616408432f5a21"   # the board's unique id (mirrormount status); or port = "socket://…", for any address
    x_axis = 2                   # the board's axis that is x; the other one of its pair is y

    [mounts.second]
    board = "e6616408437a1f2e"
    distance_mm = 600.0          # along the beam, from the mirror before; where known

    [cameras.near]
    camera = "0"                 # as --camera: an index, a device, a part of a webcam's name
    width_px = 1280              # what the camera is asked for when it is opened (CameraSettings), where it is given
    height_px = 720
    exposure = 100.0
    roi = "200,80,640,480"       # what of its pictures is looked at, where it is given: x, y, width, height in px
    distance_mm = 400.0          # along the beam, from the last mirror
    target_x_px = 320.0          # where the spot belongs
    target_y_px = 240.0

Mounts stand in the order of the beam. A mount's name may be given wherever a port may: its board is found on whatever
port it is plugged in, for a board's unique id is its USB serial number, too.
"""

import contextlib
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

from mirrormount import files
from mirrormount.device import calibration
from mirrormount.errors import BadAddress, BadFile, BadValue, NoBoardFound
from mirrormount.terminal import printable
from mirrormount.transport.discovery import find, serial_number, serial_ports
from mirrormount.values import NAME_RULE, TABLE_VARIABLE, did_you_mean, is_name, paired

AXIS_OF_X = 2  # of a board that the table does not name


# ---- from a name to a port


class MountPort(NamedTuple):
    """Where a mount is: its port's address, and the number of the axis that is x (None: nobody has said it).

    board: its unique id, "" if only its port is known.
    """

    address: str
    x_axis: int | None = None
    board: str = ""


def find_port(address: str) -> MountPort:
    """The place of a mount of the table if address is its name; else the address itself.

    Raises BadAddress for a name that the table does not have, NoBoardFound if the board is not plugged in, BadFile.
    """
    if not is_name(address) or os.path.exists(address):
        return MountPort(address)

    mounts = read().mounts
    if address in mounts:
        return port_of_entry(address, mounts[address])
    if mounts:
        raise BadAddress(
            f"{address} is no port, and no mount of {path()}: that has {', '.join(mounts)}"
            f"{did_you_mean(address, mounts)}"
            " (`mirrormount ports` lists ports)"
        )
    return MountPort(address)


def port_of_entry(name: str, entry: "MountEntry") -> MountPort:
    """Where the mount of an entry is. Raises NoBoardFound."""
    if entry.port is not None:
        return MountPort(entry.port, entry.x_axis)
    plugged = plugged_boards()
    if entry.board is None or entry.board.upper() not in plugged:
        others = f" (there: {', '.join(map(printable, plugged.values()))})" if plugged else ""
        raise NoBoardFound(f"{name}: the board {printable(str(entry.board))} is not plugged in{others}")
    return MountPort(plugged[entry.board.upper()], entry.x_axis, entry.board)


def table_addresses() -> list[str]:
    """Where the mounts of the table are, each port once, without those that are not plugged in. Raises BadFile."""
    found = {}
    for name, entry in read().mounts.items():
        with contextlib.suppress(NoBoardFound):
            found[port_of_entry(name, entry).address] = name
    return list(found)


def mounts_by_axis() -> dict[tuple[str, int], str]:
    """The names of the mounts, by their boards' unique ids in capitals and their axes' numbers. Raises BadFile."""
    return {
        (entry.board.upper(), number): name
        for name, entry in read().mounts.items()
        if entry.board
        for number in (entry.x_axis, paired(entry.x_axis))
    }


def plugged_boards() -> dict[str, str]:
    """The ports of the boards that are plugged in, by their unique ids in capitals. No port is opened."""
    serials = {port.device: serial_number(port) for port in serial_ports()}
    return {serials[device]: device for device, _ in find() if serials.get(device)}


def x_axis_of(place: MountPort, asked: int | None) -> int:
    """The number of the axis that is x: what was asked for, else what the table says."""
    return next(number for number in (asked, place.x_axis, AXIS_OF_X) if number is not None)


# ---- the file

_LONGEST_MM = 1e6
_MOST = 64  # mounts, or cameras
_HEADING = """mirrormount: the names of an optical table (docs/hold.md).
Mounts stand in the order of the beam. board: the unique id of the board; port: an address, instead. x_axis: the
board's axis that is x. distance_mm: along the beam, from the mirror before. target_x_px, target_y_px: where the spot
belongs. backend, fourcc, width_px, height_px, exposure, gain: what a webcam is asked for. roi, mask, channel,
contrast: what of a picture is looked at. Written by `mirrormount table`, which keeps what it knows but no remarks."""


@dataclass(frozen=True)
class MountEntry:
    """A mount of the table. One of board (its unique id) and port (an address) is given.

    distance_mm: along the beam from the mirror before, None if not known.
    """

    board: str | None = None
    port: str | None = None
    x_axis: int = AXIS_OF_X
    distance_mm: float | None = None


BACKENDS = ("v4l2", "dshow", "msmf", "any")
AUTOMATIC, GREY = "automatic", "grey"
CHANNELS = ("red", "green", "blue", GREY, AUTOMATIC)
SELECTING = ("roi", "mask", "channel", "contrast")  # what is asked of a picture, and not of the webcam
_LARGEST = 1e6  # number of an exposure or a gain
_MOST_GREY = 65535  # of a picture of 16 bits
_REGION = re.compile(r"\s*" + r"\s*,\s*".join([r"(-?[0-9]{1,6})"] * 4) + r"\s*")
_SIDES_PX = 32, 100_000  # of a picture that a camera is asked for


@dataclass(frozen=True)
class CameraSettings:
    """What a webcam is asked for when it is opened; None: as the camera has it. And what of a picture is looked at.

    backend: the part of OpenCV that opens it. fourcc: how pictures come over the cable, four characters, such as MJPG.
    width_px, height_px: both or neither. exposure, gain: in the numbers of the camera's driver.
    roi: "x,y,width,height" of the region, in px of the whole picture. mask: the path of a picture that is white where
    nothing is looked at. channel: one of CHANNELS. contrast: grey values of a spot's peak above its surroundings, at
    least. Raises BadValue for what no camera can have.
    """

    backend: str | None = None
    fourcc: str | None = None
    width_px: int | None = None
    height_px: int | None = None
    exposure: float | None = None
    gain: float | None = None
    roi: str | None = None
    mask: str | None = None
    channel: str | None = None
    contrast: float | None = None

    def __post_init__(self) -> None:
        if self.backend not in (None, *BACKENDS):
            named = printable(str(self.backend), 40)
            raise BadValue(f"the backend is {', '.join(BACKENDS)}, not {named!r}{did_you_mean(named, BACKENDS)}")
        code = self.fourcc
        if code is not None and not (len(code) == 4 and code.isascii() and code.isprintable()):
            raise BadValue(f"the fourcc has four characters, such as MJPG, not {printable(code, 40)!r}")
        sides = self.width_px, self.height_px
        if sides != (None, None) and not all(side and _SIDES_PX[0] <= side <= _SIDES_PX[1] for side in sides):
            raise BadValue(
                f"the size of a picture is its width and height, {_SIDES_PX[0]} … {_SIDES_PX[1]} pixels each"
            )
        for value in (self.exposure, self.gain):
            if value is not None and not abs(value) <= _LARGEST:
                raise BadValue(f"exposure and gain are numbers of at most {_LARGEST:g}")
        region = self.region
        if region and (min(region) < 0 or min(region[2:]) < _SIDES_PX[0]):
            raise BadValue(
                f"the roi is at 0,0 or more, and has {_SIDES_PX[0]} pixels or more to a side, not {self.roi}"
            )
        if self.channel not in (None, *CHANNELS):
            named = printable(str(self.channel), 40)
            raise BadValue(f"the channel is {', '.join(CHANNELS)}, not {named!r}{did_you_mean(named, CHANNELS)}")
        if self.contrast is not None and not 0 <= self.contrast <= _MOST_GREY:
            raise BadValue(f"the contrast is 0 to {_MOST_GREY} grey values, not {self.contrast:g}")

    @property
    def region(self) -> tuple[int, int, int, int] | None:
        """The roi: x, y, width, height. Raises BadValue."""
        if self.roi is None:
            return None
        match = _REGION.fullmatch(self.roi)
        if not match:
            raise BadValue(
                f"the roi is x,y,width,height in pixels, such as 200,80,640,480, not {printable(self.roi, 40)!r}"
            )
        x, y, width, height = map(int, match.groups())
        return x, y, width, height

    def over(self, other: "CameraSettings") -> "CameraSettings":
        """These settings, and those of the other where these say nothing."""
        return CameraSettings(**{**asdict(other), **self.given})

    @property
    def given(self) -> dict[str, Any]:
        """What is asked for, by name."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    @property
    def asked_of_webcam(self) -> list[str]:
        """The names of what only a webcam has."""
        return [name for name in self.given if name not in SELECTING]

    def __str__(self) -> str:
        size = f"{self.width_px} x {self.height_px} px" if self.width_px else ""
        named = ("exposure", "gain", *SELECTING)
        rest = [f"{name} {value}" for name, value in self.given.items() if name in named]
        return ", ".join(filter(None, [self.backend, self.fourcc, size, *(text.removesuffix(".0") for text in rest)]))


@dataclass(frozen=True)
class CameraEntry:
    """A camera of the table. camera: its address. distance_mm: along the beam from the last mirror.

    target_x_px, target_y_px: where the spot belongs, both or neither. settings: in the file beside the others.
    """

    camera: str
    distance_mm: float | None = None
    target_x_px: float | None = None
    target_y_px: float | None = None
    settings: CameraSettings = CameraSettings()

    @property
    def target_px(self) -> tuple[float, float] | None:
        """Where the spot belongs, None if nobody has said it."""
        if self.target_x_px is None or self.target_y_px is None:
            return None
        return self.target_x_px, self.target_y_px


@dataclass(frozen=True)
class TableFile:
    """What the file holds: mounts in the order of the beam, cameras in that of the file."""

    mounts: Mapping[str, MountEntry] = field(default_factory=dict)
    cameras: Mapping[str, CameraEntry] = field(default_factory=dict)


def path() -> Path:
    """The path of the file."""
    named = os.environ.get(TABLE_VARIABLE)
    return Path(named) if named else calibration.path().with_name("table.toml")


def read() -> TableFile:
    """The file's mounts and cameras; empty if there is no file and none was named. Raises BadFile."""
    where = path()
    if os.environ.get(TABLE_VARIABLE) and not where.is_file():
        found = "a folder or a device is there, no" if where.exists() else "there is no such"
        raise BadFile(f"{where}: {found} file of a table")
    tables = files.read_toml(where)
    for key in tables:
        if key not in ("mounts", "cameras"):
            raise BadFile(f"{where}: [{printable(key, 40)}] is not known: [mounts.NAME] and [cameras.NAME] are")
    table = TableFile(
        _entries(tables, "mounts", where, _mount),
        _entries(tables, "cameras", where, _camera),
    )
    _check_each_is_one_thing(table, where)
    return table


def write(table: TableFile) -> Path:
    """Write the file. Returns its path. Raises CannotWrite."""
    kinds = {"mounts": table.mounts, "cameras": table.cameras}
    tables = {kind: {name: _flat(asdict(entry)) for name, entry in entries.items()} for kind, entries in kinds.items()}
    where = path()
    files.write_atomic(where.resolve(), files.toml_text(tables, _HEADING), make_folder=True)
    return where


def _flat(entry: dict[str, Any]) -> dict[str, Any]:
    """What is known of an entry. A camera's settings stand beside the rest."""
    entry |= entry.pop("settings", {})
    return {key: value for key, value in entry.items() if value is not None}


def check_name(name: str) -> str:
    """The name, if a mount or a camera may have it. Raises BadValue."""
    if not is_name(name):
        raise BadValue(f"{printable(name, 40)!r} is no name: {NAME_RULE}")
    return name


def _entries(tables: Mapping[str, Any], kind: str, where: Path, parsed: Callable[[dict[str, Any], str], Any]) -> Any:
    entries = tables.get(kind, {})
    if not isinstance(entries, dict) or len(entries) > _MOST:
        raise BadFile(f"{where}: [{kind}] holds at most {_MOST} tables, one for each name")
    found = {}
    for name, entry in entries.items():
        place = f"{where}: [{kind}.{printable(name, 40)}]"
        if not is_name(name):
            raise BadFile(f"{place}: a name is {NAME_RULE}")
        if not isinstance(entry, dict):
            raise BadFile(f"{place} is not a table")
        found[name] = parsed(entry, place)
    return found


def _mount(entry: dict[str, Any], where: str) -> MountEntry:
    _only(entry, _names(MountEntry), where)
    board, port = _text(entry, "board", where), _text(entry, "port", where)
    if (board is None) == (port is None):
        raise BadFile(f"{where}: give the board's id (board = …) or an address (port = …), one of them")
    x_axis = entry.get("x_axis", AXIS_OF_X)
    if isinstance(x_axis, bool) or not isinstance(x_axis, int) or not 1 <= x_axis <= 4:
        raise BadFile(f"{where}: x_axis is the number of an axis, 1 to 4")
    return MountEntry(board, port, x_axis, _length(entry, "distance_mm", where))


def _camera(entry: dict[str, Any], where: str) -> CameraEntry:
    _only(entry, [name for name in _names(CameraEntry) if name != "settings"] + _names(CameraSettings), where)
    camera = _text(entry, "camera", where)
    if camera is None:
        raise BadFile(f"{where}: camera is missing: an index, a device, or a part of the webcam's name")
    x, y = _pixel(entry, "target_x_px", where), _pixel(entry, "target_y_px", where)
    if (x is None) != (y is None):
        raise BadFile(f"{where}: a target is target_x_px and target_y_px, both")
    return CameraEntry(camera, _length(entry, "distance_mm", where), x, y, _settings(entry, where))


def _settings(entry: Mapping[str, Any], where: str) -> CameraSettings:
    backend, fourcc = _text(entry, "backend", where), _text(entry, "fourcc", where)
    width, height = _whole(entry, "width_px", where), _whole(entry, "height_px", where)
    exposure, gain = _number(entry, "exposure", where), _number(entry, "gain", where)
    roi, mask, channel = (_text(entry, name, where) for name in ("roi", "mask", "channel"))
    mask = mask and str(path().parent / mask)  # a path in the file begins at its folder
    contrast = _number(entry, "contrast", where)
    try:
        return CameraSettings(backend, fourcc, width, height, exposure, gain, roi, mask, channel, contrast)
    except BadValue as e:
        raise BadFile(f"{where}: {e}") from e


def _check_each_is_one_thing(table: TableFile, where: Path) -> None:
    """Raises BadFile where two names are for one pair of axes, or one camera, or one name is for two things."""
    pairs: dict[tuple[str, int], str] = {}
    for name, entry in table.mounts.items():
        board = entry.board.upper() if entry.board else f"port {entry.port}"
        other = pairs.setdefault((board, (entry.x_axis - 1) // 2), name)
        if other != name:
            axes = "1 and 2" if entry.x_axis < 3 else "3 and 4"
            raise BadFile(
                f"{where}: [mounts.{name}] is the same board and pair of axes ({axes}) as {other}: give its own board,"
                " or x_axis = 1 or 2 to the one and 3 or 4 to the other"
            )
    cameras: dict[str, str] = {}
    for name, camera in table.cameras.items():
        other = cameras.setdefault(camera.camera.lower(), name)
        if other != name:
            raise BadFile(f"{where}: [cameras.{name}] is the same camera as {other}: give it its own, or leave it out")
        if name in table.mounts:
            raise BadFile(f"{where}: {name} is a mount and a camera: give one of them another name")


def _names(kind: type) -> list[str]:
    return [each.name for each in fields(kind)]


def _only(entry: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in entry:
        if key not in known:
            named = printable(key, 40)
            raise BadFile(f"{where}: {named} is not known: {', '.join(known)} are{did_you_mean(named, known)}")


def _text(entry: Mapping[str, Any], key: str, where: str) -> str | None:
    value = entry.get(key)
    if value is None:
        return None
    if not isinstance(value, str) or not value.strip() or len(value) > 200 or not value.isprintable():
        raise BadFile(f'{where}: {key} is a text in quotes, such as "0"')
    return value


def _length(entry: Mapping[str, Any], key: str, where: str) -> float | None:
    value = _number(entry, key, where)
    if value is not None and not 0 < value <= _LONGEST_MM:
        raise BadFile(f"{where}: {key} is above 0 and at most {_LONGEST_MM:g}")
    return value


def _pixel(entry: Mapping[str, Any], key: str, where: str) -> float | None:
    value = _number(entry, key, where)
    if value is not None and not 0 <= value < 1e5:
        raise BadFile(f"{where}: {key} is a place in the picture, from 0")
    return value


def _whole(entry: Mapping[str, Any], key: str, where: str) -> int | None:
    value = entry.get(key)
    if value is not None and (isinstance(value, bool) or not isinstance(value, int)):
        raise BadFile(f"{where}: {key} is a whole number")
    return value


def _number(entry: Mapping[str, Any], key: str, where: str) -> float | None:
    value = entry.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadFile(f"{where}: {key} is a number")
    return float(value)
