"""An image for an ESP32, which esptool writes; here esptool is only called, or told. Not tried on hardware.

The header of an image: its first byte is 0xE9, and at byte 12 is the chip's number (docs.espressif.com, esptool,
"Firmware Image Format"). MicroPython's and CircuitPython's images begin with the boot loader, so they belong where the
ROM looks for that: 0x1000 on an ESP32 (number 0) and an ESP32-S2 (2), 0 on the others.
"""

import importlib.util
import subprocess
from pathlib import Path

from mirrormount.errors import DeployError, ImageMissing
from mirrormount.terminal import Progress, python_module

_MAGIC, _CHIP_AT, _LATE = b"\xe9", 12, (0, 2)


def _head(image: Path) -> bytes:
    try:
        with image.open("rb") as file:
            return file.read(_CHIP_AT + 2)
    except OSError:
        return b""


def is_image(image: Path) -> bool:
    """True for an image of an ESP32 of any kind."""
    return _head(image).startswith(_MAGIC)


def write(image: Path, port: str | None, progress: Progress) -> str:
    """Write the image by esptool. Returns one line that says how to go on. Raises ImageMissing, DeployError."""
    if port is None:
        raise DeployError("an ESP board is written through its serial port: mirrormount flash PORT --image FILE")
    address = "0x1000" if int.from_bytes(_head(image)[_CHIP_AT:], "little") in _LATE else "0x0"
    words = ["--port", port, "write_flash", address, str(image)]  # esptool 4 knows no write-flash, 5 still knows this
    if importlib.util.find_spec("esptool") is None:
        line = " ".join(["esptool", *words])
        raise ImageMissing(f"an ESP board needs esptool, and it is not here: pip install esptool, then {line}")
    progress.phase("writing by esptool (not tried on hardware)")
    if status := subprocess.call(python_module("esptool", *words)):
        raise DeployError(f"esptool has failed (exit status {status}); its lines above say why")
    return "OK: written by esptool. Press reset, then mirrormount deploy; not tried on hardware"
