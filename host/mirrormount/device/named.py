"""From a mount's name in table.toml to its port: by the unique id of its board, which is its USB serial number, too."""

import contextlib
import os
from typing import TYPE_CHECKING, NamedTuple

from mirrormount.common.errors import BadAddress, NoBoardFound
from mirrormount.common.names import is_name
from mirrormount.common.printable import printable
from mirrormount.transport.circuitpy_ports import serial_number
from mirrormount.transport.find import find, serial_ports

if TYPE_CHECKING:
    from mirrormount.device.table_file import MountEntry

AXIS_OF_X = 2  # of a board that the table does not name


class Place(NamedTuple):
    """Where a mount is: its port's address, and the number of the axis that is x (None: nobody has said it)."""

    address: str
    x_axis: int | None = None


def place_of(address: str) -> Place:
    """The place of a mount of the table if address is its name; else the address itself.

    Raises BadAddress for a name that the table does not have, NoBoardFound if the board is not plugged in, BadFile.
    """
    if not is_name(address) or os.path.exists(address):
        return Place(address)
    from mirrormount.device import table_file  # a port's own name needs no reader of files

    mounts = table_file.read().mounts
    if address in mounts:
        return place_of_entry(address, mounts[address])
    if mounts:
        raise BadAddress(
            f"{address} is no port, and no mount of {table_file.path()}: that has {', '.join(mounts)}"
            " (`mirrormount ports` lists ports)"
        )
    return Place(address)


def place_of_entry(name: str, entry: "MountEntry") -> Place:
    """Where the mount of an entry is. Raises NoBoardFound."""
    if entry.port is not None:
        return Place(entry.port, entry.x_axis)
    plugged = boards()
    if entry.board is None or entry.board.upper() not in plugged:
        others = f" (there: {', '.join(map(printable, plugged.values()))})" if plugged else ""
        raise NoBoardFound(f"{name}: the board {printable(str(entry.board))} is not plugged in{others}")
    return Place(plugged[entry.board.upper()], entry.x_axis)


def addresses() -> list[str]:
    """Where the mounts of the table are, each port once, without those that are not plugged in. Raises BadFile."""
    from mirrormount.device import table_file

    found = {}
    for name, entry in table_file.read().mounts.items():
        with contextlib.suppress(NoBoardFound):
            found[place_of_entry(name, entry).address] = name
    return list(found)


def boards() -> dict[str, str]:
    """The ports of the boards that are plugged in, by their unique ids in capitals. No port is opened."""
    serials = {port.device: serial_number(port) for port in serial_ports()}
    return {serials[device]: device for device, _ in find() if serials.get(device)}


def x_axis_of(place: Place, asked: int | None) -> int:
    """The number of the axis that is x: what was asked for, else what the table says."""
    return next(number for number in (asked, place.x_axis, AXIS_OF_X) if number is not None)
