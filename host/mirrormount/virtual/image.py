"""The MicroPython image that the rp2040 machine boots: the one named, else a kept one, the official one, Debian's.

The official image is used only if its SHA-256 is the one written here: whoever stands between
micropython.org and this computer cannot put another in its place. With CI=true nobody is asked for it.
"""

import contextlib
import hashlib
import http.client
import os
import queue
import re
import shutil
import struct
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from platformdirs import user_cache_path

from mirrormount.common.errors import EmulatorMissing
from mirrormount.deploy.firmware import MPY_OF_PICO

TOOLS = Path(__file__).parents[3] / "tools" / "emulator"
_MOST_BYTES = 32 << 20  # a .uf2 is twice as long as what it holds, and no RP2040 has more than 16 MB of flash
_RP2040 = struct.pack("<I", 0xE48BFF56)  # the family of a .uf2's blocks
_VECTORS = 0x100  # behind the second stage of the boot loader: the stack's end and the first instruction
_FLASH, _RAM, _RAM_BYTES = 0x10000000, 0x20000000, 0x42000
_PATIENCE_S = 5.0  # until the site answers, and between two pieces of what it sends


@dataclass(frozen=True)
class Official:
    """A published image: where it is, its SHA-256 and its bytes."""

    url: str
    sha256: str
    size: int

    @property
    def name(self) -> str:
        """The file's name."""
        return self.url.rpartition("/")[2]


# MicroPython 1.25.0 for the Pico. The sum is that of two copies in public repositories of different people
# (BrianPugh/hdiffpatch-python and 206cc/PicoBETH), which are the same to the byte.
OFFICIAL = Official(
    "https://micropython.org/resources/firmware/RPI_PICO-20250415-v1.25.0.uf2",
    "e0c40eacf1afc550a6add74888c48bb981b28788a6d75a62a0e2444e997b9864",
    667_648,
)


class NotFetched(Exception):
    """The official image was not to be had."""


class Refused(NotFetched):
    """Something else came in its place."""


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
    """The MicroPython image to run: that one, else one in the cache, else the official one, else one built now.

    Raises EmulatorMissing.
    """
    if image is not None:
        _check_boots(image)
        return image
    folder = cache() / "images"
    if found := _kept(folder):
        return found
    with held("image"):  # two builds in one folder would undo each other
        return _kept(folder) or _made(folder)


def _kept(folder: Path) -> Path | None:
    found = sorted([*folder.glob("*.uf2"), *folder.glob("*.bin")])
    return found[-1] if found else None


def _made(folder: Path) -> Path:
    """Fetch or build an image. Raises EmulatorMissing."""
    try:
        return fetch(OFFICIAL, folder)
    except NotFetched as e:
        if not can_build():
            raise EmulatorMissing(
                f"no MicroPython image: {e}; give one with --image FILE, or put RPI_PICO-*.uf2 into {folder}"
                " (on Debian with gcc-arm-none-eabi, cmake and dpkg-dev one is built)"
            ) from e
        if isinstance(e, Refused):
            print(f"mirrormount: {e}", file=sys.stderr)
    return build(folder)


def is_circuitpython(image: Path) -> bool:
    """True for an image of CircuitPython, which is never fetched or built here; False for one of MicroPython.

    Raises EmulatorMissing.
    """
    return b"Adafruit CircuitPython" in _content(image)


def mpy_of(image: Path) -> int:
    """What sys.implementation._mpy is of a MicroPython for the RP2040 from 1.22 on. Raises EmulatorMissing."""
    minor = re.search(rb"MicroPython v1\.(\d+)", _content(image))
    return MPY_OF_PICO if minor and int(minor[1]) > 22 else MPY_OF_PICO - (1 << 8)


def _check(image: Path) -> None:
    """Raise EmulatorMissing if that is no file of an image's size."""
    if not image.is_file():
        raise EmulatorMissing(f"{image}: there is no such image")
    if image.stat().st_size > _MOST_BYTES:
        raise EmulatorMissing(f"{image}: an image has at most {_MOST_BYTES >> 20} MB")


def _content(image: Path) -> bytes:
    """The contents of the blocks of a .uf2 for the RP2040, joined; of any other file all. Raises EmulatorMissing."""
    _check(image)
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
    if not (_RAM < stack <= _RAM + _RAM_BYTES and _FLASH < first < _FLASH + _MOST_BYTES // 2 and first % 2):
        raise EmulatorMissing(f"{image}: that is no image for an RP2040")


def fetch(official: Official, folder: Path) -> Path:
    """Fetch the image into the folder. Nothing else is ever written there. Raises NotFetched."""
    if os.environ.get("CI", "").lower() == "true":
        raise NotFetched("with CI=true none is fetched")
    try:
        with _open(official.url) as answer:
            data = answer.read(official.size + 1)
    except (OSError, http.client.HTTPException) as e:
        raise NotFetched(f"{official.url} cannot be had ({getattr(e, 'reason', e)})") from e
    digest = hashlib.sha256(data).hexdigest()
    if digest != official.sha256:
        raise Refused(f"{official.url}: not the image that it should be (its SHA-256 begins {digest[:12]}), not used")
    folder.mkdir(parents=True, exist_ok=True)
    image = folder / official.name
    part = image.with_suffix(".part")
    part.write_bytes(data)
    part.replace(image)
    print(f"fetched {official.url}, once", file=sys.stderr)
    return image


def can_build() -> bool:
    """True where Debian's sources and a cross compiler are."""
    return Path("/etc/debian_version").exists() and shutil.which("arm-none-eabi-gcc") is not None


def build(folder: Path) -> Path:
    """Build one from Debian's sources. Raises EmulatorMissing."""
    print("building a MicroPython image from Debian's sources, once; this takes some minutes", file=sys.stderr)
    built = subprocess.run(["bash", str(TOOLS / "build_image.sh"), str(folder)], capture_output=True, text=True)
    if built.returncode:
        raise EmulatorMissing(f"building the image failed: {last_line(built.stderr)}; logs are in {folder}")
    return Path(built.stdout.split()[-1])


def last_line(text: str) -> str:
    """The last line that is not empty."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else "no reason given"


def _open(url: str) -> IO[bytes]:
    """Open url. Raises OSError, also when nothing answers in time: looking its name up has no limit of its own."""
    answers: queue.SimpleQueue[IO[bytes] | Exception] = queue.SimpleQueue()

    def ask() -> None:
        try:
            answers.put(urllib.request.urlopen(url, timeout=_PATIENCE_S))
        except Exception as e:
            answers.put(e)

    threading.Thread(target=ask, name="download", daemon=True).start()
    try:
        answer = answers.get(timeout=_PATIENCE_S)
    except queue.Empty:
        raise TimeoutError("no answer") from None
    if isinstance(answer, urllib.error.HTTPError):
        answer.close()
    if isinstance(answer, Exception):
        raise answer
    return answer
