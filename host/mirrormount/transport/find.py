"""Which serial ports lead to a mount, by USB ids and drives. Opens none. Imports circuitpy_drives, circuitpy_ports."""

from serial.tools import list_ports

from mirrormount.common.errors import NoBoardFound, SeveralBoardsFound
from mirrormount.transport import circuitpy_ports
from mirrormount.transport.circuitpy_drives import find_drives

# USB ids (vendor, product) that are certainly a MicroPython board. CircuitPython boards have hundreds: they are
# known by their drives. An Adafruit Feather RP2040 has the same id (239a:80f2) with either, so it is not here. Nothing
# else is ever written to unasked: an unknown port may be another instrument.
KNOWN_IDS = {(0x2E8A, 0x0005): "MicroPython on RP2040/RP2350"}


def find() -> list[tuple[str, str]]:
    """The serial ports of possible mounts: (device, description).

    A CircuitPython board is one of them if its drive is mounted and has mountfw on it: then its data channel, or
    its console if it has one channel.
    """
    ports = serial_ports()
    drives = find_drives()
    return _micropython(ports) + (circuitpy_ports.mounts(drives, ports) if drives else [])


def find_micropython() -> list[tuple[str, str]]:
    """The serial ports of MicroPython boards: (device, description)."""
    return _micropython(serial_ports())


def find_one() -> str:
    """The port of the only possible mount. Raises NoBoardFound or SeveralBoardsFound."""
    found = [device for device, _ in find()]
    if not found:
        if unknown := circuitpy_ports.unknown_data_channels(serial_ports()):
            raise NoBoardFound(
                f"a CircuitPython board listens at {', '.join(unknown)}, but its drive is not mounted here, so nobody"
                " knows what it is: if it is the mount, name the port"
            )
        raise NoBoardFound("no board found: plug one in, name its port, or use --port virtual://")
    if len(found) > 1:
        raise SeveralBoardsFound(f"several boards found, name one with --port: {', '.join(found)}")
    return found[0]


def serial_ports() -> list:
    """All serial ports of this computer, as pyserial lists them, sorted by device."""
    return sorted(list_ports.comports(), key=lambda port: port.device)


def _micropython(ports: list) -> list[tuple[str, str]]:
    return [(port.device, KNOWN_IDS[port.vid, port.pid]) for port in ports if (port.vid, port.pid) in KNOWN_IDS]
