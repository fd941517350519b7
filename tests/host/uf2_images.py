"""Images for tests, with what flash reads of one and nothing that runs; and the drive of a boot loader."""

import shutil
import struct
import threading
from collections.abc import Callable
from pathlib import Path

from served import wait_for

RP2040, RP2350, ABSOLUTE = 0xE48BFF56, 0xE48BFF59, 0xE48BFF57
FLASH, FILES, FILES_BYTES = 0x10000000, 0x100A0000, 1408 << 10  # a Pico's
MACHINES = {RP2040: "Raspberry Pi Pico with RP2040", RP2350: "Raspberry Pi Pico 2 with RP2350"}


def block(address: int, data: bytes, number: int, count: int, family: int, flags: int = 0x2000) -> bytes:
    """A block of a .uf2 (github.com/microsoft/uf2)."""
    head = struct.pack("<8I", 0x0A324655, 0x9E5D5157, flags, address, len(data), number, count, family)
    return head + data.ljust(476, b"\0") + struct.pack("<I", 0x0AB16F30)


def program(version: str = "1.25.0", machine: str = MACHINES[RP2040], files: tuple[int, int] = (FILES, FILES_BYTES)):
    """A program's bytes: its binary info names the file system, and a string the release and the board."""
    entry, name, table, words = 0x240, 0x260, 0x280, 0x300
    data = bytearray(0x1800 - 256)  # no whole number of sectors
    struct.pack_into("<5I", data, 0x110, 0x7188EBF2, FLASH + table, FLASH + table + 4, 0, 0xE71AA390)
    struct.pack_into("<I", data, table, FLASH + entry)
    struct.pack_into("<HH4I", data, entry, 7, 0x504D, FLASH + name, *files, 0)
    data[name : name + 12] = b"MicroPython\0"
    text = f"MicroPython v{version} on 2025-04-15; {machine}\0{machine}\0".encode() if version else b""
    data[words : words + len(text)] = text
    return bytes(data)


def image(data: bytes | None = None, family: int = RP2040) -> bytes:
    """A whole .uf2 of a program; an RP2350's begins with the block of erratum E10."""
    data = program(machine=MACHINES.get(family, "")) if data is None else data
    count = -(-len(data) // 256)
    parts = [block(FLASH + 256 * n, data[256 * n : 256 * (n + 1)], n, count, family) for n in range(count)]
    first = [block(0x10FFFF00, bytes(256), 0, 2, ABSOLUTE, 0xA000)] if family == RP2350 else []
    return b"".join(first + parts)


def put(folder: Path, data: bytes, name: str = "image.uf2") -> Path:
    (folder / name).write_bytes(data)
    return folder / name


def make_drive(path: Path, board_id: str = "RPI-RP2") -> Path:
    """The drive that the boot loader of an RP2040 (or of another chip) shows."""
    path.mkdir()
    (path / "INFO_UF2.TXT").write_text(f"UF2 Bootloader v3.0\r\nModel: Raspberry Pi RP2\r\nBoard-ID: {board_id}\r\n")
    (path / "INDEX.HTM").write_text("<html></html>")
    return path


class Rom(threading.Thread):
    """A boot loader: when a whole image is on its drive, the drive goes, and restart() is called."""

    def __init__(self, drive: Path, restart: Callable[[], object]) -> None:
        super().__init__(daemon=True)
        self._drive = drive
        self._restart = restart
        self.taken = b""
        self.start()

    def _whole(self) -> bytes:
        for file in self._drive.glob("*.uf2"):
            data = file.read_bytes()
            number, count = struct.unpack_from("<II", data, len(data) - 492) if len(data) >= 512 else (0, 0)
            if len(data) % 512 == 0 and number + 1 == count:  # of the last block
                return data
        return b""

    def run(self) -> None:
        self.taken = bytes(wait_for(self._whole, "an image on the drive"))  # pyright: ignore
        shutil.rmtree(self._drive)
        self._restart()
