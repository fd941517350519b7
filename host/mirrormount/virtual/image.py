"""The MicroPython image that the rp2040 machine boots: the one named, else one in the cache, else one built here."""

import contextlib
import os
import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from platformdirs import user_cache_path

from mirrormount.common.errors import EmulatorMissing
from mirrormount.deploy.fileset import MPY_OF_PICO

TOOLS = Path(__file__).parents[3] / "tools" / "emulator"
_RP2040 = struct.pack("<I", 0xE48BFF56)  # the family of a .uf2's blocks
_VECTORS = 0x100  # behind the second stage of the boot loader: the stack's end and the first instruction
_FLASH, _FLASH_BYTES, _RAM, _RAM_BYTES = 0x10000000, 16 << 20, 0x20000000, 0x42000


def cache() -> Path:
    """The folder where the emulator's parts are kept."""
    folder = os.environ.get("MIRRORMOUNT_CACHE")
    return Path(folder) if folder else user_cache_path("mirrormount")


@contextlib.contextmanager
def held(name: str) -> Iterator[None]:
    """Hold a lock of the cache folder, so that one process at a time makes what is kept there; the next one finds it.

    Systems without fcntl (Windows) have no such lock. Raises EmulatorMissing if the folder cannot be written to.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    try:
        cache().mkdir(parents=True, exist_ok=True)
        file = (cache() / f"{name}.lock").open("a")
    except OSError as e:
        raise EmulatorMissing(
            f"{cache()} cannot be written to ({e.strerror}): name another with MIRRORMOUNT_CACHE"
        ) from e
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def find_image(image: Path | None) -> Path:
    """The MicroPython image to run: that one, else the last one of the cache, else one built now.

    Raises EmulatorMissing.
    """
    if image is not None:
        _check_boots(image)
        return image
    folder = cache() / "images"
    if found := _kept(folder):
        return found
    with held("image"):  # two builds in one folder would undo each other
        return _kept(folder) or build(folder)


def _kept(folder: Path) -> Path | None:
    found = sorted([*folder.glob("*.uf2"), *folder.glob("*.bin")])
    return found[-1] if found else None


def is_circuitpython(image: Path) -> bool:
    """True for an image of CircuitPython, which is never built here; False for one of MicroPython.

    Raises EmulatorMissing.
    """
    return b"Adafruit CircuitPython" in _content(image)


def mpy_of(image: Path) -> int:
    """What sys.implementation._mpy is of a MicroPython for the RP2040 from 1.22 on. Raises EmulatorMissing."""
    minor = re.search(rb"MicroPython v1\.(\d+)", _content(image))
    return MPY_OF_PICO if minor and int(minor[1]) > 22 else MPY_OF_PICO - (1 << 8)


def _content(image: Path) -> bytes:
    """The contents of the blocks of a .uf2 for the RP2040, joined; of any other file all. Raises EmulatorMissing."""
    if not image.is_file():
        raise EmulatorMissing(f"{image}: there is no such image")
    try:
        data = image.read_bytes()
    except OSError as e:
        raise EmulatorMissing(f"{image}: {e.strerror}") from e
    if not data.startswith(b"UF2\n"):
        return data
    blocks = (data[at : at + 512] for at in range(0, len(data), 512))
    return b"".join(block[32 : 32 + 256] for block in blocks if block[28:32] == _RP2040)


def _check_boots(image: Path) -> None:
    """Raise EmulatorMissing if an RP2040 could not start with it."""
    start = _content(image)[_VECTORS : _VECTORS + 8]
    stack, first = struct.unpack("<II", start) if len(start) == 8 else (0, 0)
    if not (_RAM < stack <= _RAM + _RAM_BYTES and _FLASH < first < _FLASH + _FLASH_BYTES and first % 2):
        raise EmulatorMissing(f"{image}: that is no image for an RP2040")


def build(folder: Path) -> Path:
    """Build one from Debian's sources. Raises EmulatorMissing, also where that is impossible."""
    if not Path("/etc/debian_version").exists() or shutil.which("arm-none-eabi-gcc") is None:
        raise EmulatorMissing(
            f"no MicroPython image: put RPI_PICO-*.uf2 of micropython.org/download/RPI_PICO into {folder}, or give it"
            " with --image FILE (on Debian with gcc-arm-none-eabi, cmake and dpkg-dev one is built)"
        )
    print("building a MicroPython image from Debian's sources, once; this takes some minutes", file=sys.stderr)
    built = subprocess.run(["bash", str(TOOLS / "build_image.sh"), str(folder)], capture_output=True, text=True)
    if built.returncode:
        raise EmulatorMissing(f"building the image failed: {last_line(built.stderr)}; logs are in {folder}")
    return Path(built.stdout.split()[-1])


def last_line(text: str) -> str:
    """The last line that is not empty."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else "no reason given"
