"""deploy and undeploy on a MicroPython VM whose file system is a folder, through the real mpremote."""

import hashlib
import io
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from deployed import THEIRS, contents, listed, mpy_of_the_vm
from served import run_cli, wait_for

import mountfw
from mirrormount import errors
from mirrormount.deploy import micropython
from mirrormount.deploy.firmware import firmware, firmware_hash
from mirrormount.deploy.micropython import Mpremote, Survey, deploy
from mirrormount.deploy.prompt import Options, may_replace
from mirrormount.device.mount import Mount
from mirrormount.supported import MICROPYTHON

PACKAGE = Path(mountfw.__file__).parent / "package.json"


@pytest.mark.parametrize("command", ["deploy", "undeploy"])
def test_an_address_that_is_no_serial_port_is_told_to_both_commands_by_name(command):
    run = run_cli(command, "--port", "virtual://")
    assert run.returncode == 1
    told = "deploy and undeploy need a serial port, not virtual://: mirrormount ports lists them"
    assert run.stderr == f"mirrormount: {told}\n"


def test_deploy_to_a_blank_board_makes_it_a_mount(boot):
    board = boot()
    done = board.deploy()
    assert done.returncode == 0, done.stderr
    count = len(listed(board.root))
    assert (
        f"OK: Raspberry Pi Pico, mountfw {mountfw.__version__}, 2 axes, {count} files (0 unchanged) in" in done.stdout
    )
    with Mount.open(board.port) as mount:
        mount.x.step(1)
        assert mount.x.position == 1


@pytest.mark.full
def test_a_board_holds_the_manifest_and_what_it_lists_and_nothing_else(boot):
    board = boot()
    board.deploy()
    assert set(contents(board.root)) == listed(board.root) | {"mountfw/manifest.json"}


def test_a_board_that_was_deployed_to_starts_by_itself(deployed):
    assert deployed.ask("VE?") == f"MM2 Version {mountfw.__version__} mirrormount"


def test_a_second_deploy_changes_nothing(deployed):
    before = {p: p.stat().st_mtime_ns for p in deployed.root.rglob("*")}
    done = deployed.deploy()
    assert f"({len(listed(deployed.root))} unchanged)" in done.stdout, done.stderr
    assert {p: p.stat().st_mtime_ns for p in deployed.root.rglob("*")} == before


def test_deploy_over_an_older_version_changes_what_differs_and_removes_what_is_no_more(deployed):
    manifest = json.loads((deployed.root / "mountfw" / "manifest.json").read_text())
    for name, text in (("motion/axis.mpy", b"old"), ("gone.mpy", b"older")):
        (deployed.root / "mountfw" / name).write_bytes(text)
        manifest["files"][f"mountfw/{name}"] = hashlib.sha256(text).hexdigest()
    (deployed.root / "mountfw" / "manifest.json").write_text(json.dumps(manifest))
    done = deployed.deploy()
    assert f"({len(listed(deployed.root)) - 1} unchanged)" in done.stdout, done.stderr
    assert not (deployed.root / "mountfw" / "gone.mpy").exists()


def test_a_plain_file_that_would_hide_a_compiled_one_goes(deployed):
    (deployed.root / "mountfw" / "motion" / "axis.py").write_text("raise SystemError\n")
    assert deployed.deploy().returncode == 0
    assert not (deployed.root / "mountfw" / "motion" / "axis.py").exists()


@pytest.mark.full
def test_source_puts_plain_files_on_the_board(deployed):
    assert deployed.deploy("--source").returncode == 0
    assert contents(deployed.root)["mountfw/motion/axis.py"] == (PACKAGE.parent / "motion" / "axis.py").read_bytes()
    assert not list((deployed.root / "mountfw").rglob("*.mpy"))


def test_no_folder_of_this_computer_is_in_a_compiled_file(deployed_files):
    for name, content in contents(deployed_files).items():
        assert str(PACKAGE.parent.parent).encode() not in content and b"source.py" not in content, name


def test_the_boards_hash_is_over_what_is_really_there(boot, deployed_files, tmp_path):
    root = Path(shutil.copytree(deployed_files, tmp_path / "other"))
    hashes = {name: hashlib.sha256(text).hexdigest() for name, text in contents(root).items()}
    assert boot(root).ask("XF?") == firmware_hash(hashes)
    (root / "mountfw" / "boards" / "mine.py").write_text("# another file\n")
    assert boot(root).ask("XF?") != firmware_hash(hashes)


def test_a_board_that_moves_is_neither_stopped_nor_changed(deployed):
    before = contents(deployed.root)
    deployed.run()
    done = deployed.deploy()
    assert done.returncode == 1 and "a motor moves" in done.stderr
    assert deployed.board.driving()
    assert contents(deployed.root) == before


def test_told_to_stop_deploy_stops_and_goes_on(deployed):
    deployed.run()
    done = deployed.deploy("--stop")
    assert done.returncode == 0, done.stderr
    assert not deployed.board.driving()


def test_somebody_elses_main_py_stays_unless_one_says_so(boot, tmp_path):
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "main.py").write_text(THEIRS)
    board = boot()
    done = board.deploy()
    assert done.returncode == 1 and "--replace-main" in done.stderr
    assert contents(board.root) == {"main.py": THEIRS.encode()}


@pytest.mark.full
def test_replacing_somebody_elses_main_py_keeps_a_copy_and_spares_older_ones(boot, tmp_path):
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "main.py").write_text(THEIRS)
    (tmp_path / "files" / "main.py.bak").write_text("older")
    board = boot()
    done = board.deploy("--replace-main")
    assert "main.py.bak2" in done.stdout, done.stderr
    assert (board.root / "main.py.bak2").read_text() == THEIRS
    assert (board.root / "main.py.bak").read_text() == "older"
    assert "power-up" in (board.root / "main.py").read_text()


def test_undeploy_leaves_what_the_user_has_put_there(deployed):
    theirs = {"boot.py": "", "notes.txt": "mine", "mountfw/boards/mine.py": "NAME = b''", "settings.json": "{}"}
    for name, text in theirs.items():
        (deployed.root / name).write_text(text)
    done = run_cli("undeploy", deployed.port)
    assert done.returncode == 0, done.stderr
    assert contents(deployed.root) == {name: text.encode() for name, text in theirs.items()}


def test_undeploy_removes_what_a_save_left_that_found_the_flash_full(deployed):
    (deployed.root / "mountfw.settings.new").write_text("1 pulse_us")
    (deployed.root / "mine.new").write_text("mine")
    done = run_cli("undeploy", deployed.port)
    assert done.returncode == 0, done.stderr
    assert contents(deployed.root) == {"mine.new": b"mine"}


def test_undeploy_keeps_a_file_that_was_changed_since_and_says_so(deployed):
    (deployed.root / "mountfw" / "boards" / "pico.mpy").write_bytes(b"mine")
    done = run_cli("undeploy", deployed.port)
    assert "kept, because changed since: mountfw/boards/pico.mpy" in done.stdout
    assert contents(deployed.root) == {"mountfw/boards/pico.mpy": b"mine"}


def test_undeploy_of_a_board_that_was_not_deployed_to_removes_nothing(boot, tmp_path):
    root = Path(shutil.copytree(PACKAGE.parent, tmp_path / "files" / "mountfw")).parent
    before = contents(root)
    done = run_cli("undeploy", boot(root).port)
    assert done.returncode == 1 and "nothing was removed" in done.stderr and "removing" not in done.stderr
    assert contents(root) == before


def test_an_upload_that_fails_leaves_the_old_firmware_running_and_nothing_else(deployed, monkeypatch):
    before = contents(deployed.root)
    monkeypatch.setattr(micropython, "beside", lambda path: f"nowhere/{path}")
    with pytest.raises(errors.DeployError, match=r"the upload failed .*; the board has the firmware that it had"):
        deploy(Options(port=deployed.port, source=True))
    assert contents(deployed.root) == before
    assert wait_for(lambda: deployed.ask("VE?"), "the old firmware")


@pytest.mark.full
def test_undeploy_gives_a_program_that_was_put_aside_its_name_back(boot, tmp_path):
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "main.py").write_text(THEIRS)
    board = boot()
    assert board.deploy("--replace-main").returncode == 0
    assert board.deploy("--source").returncode == 0
    assert "there again: main.py" in run_cli("undeploy", board.port).stdout
    assert contents(board.root) == {"main.py": THEIRS.encode()}


@pytest.mark.full
def test_a_board_without_a_board_file_is_named_before_anything_is_uploaded(deployed, monkeypatch):
    before = contents(deployed.root)
    real = Mpremote.survey
    monkeypatch.setattr(Mpremote, "survey", lambda self: replace(real(self), machine="Odd\x1b[2JBoard with RP2040"))
    with pytest.raises(errors.DeployError) as e:
        deploy(Options(port=deployed.port, source=True))
    assert r"no board file for a 'Odd\x1b[2JBoard'" in str(e.value)
    assert "--board (adafruit_feather_esp32s3, " in str(e.value) and "--pins FILE" in str(e.value)
    assert contents(deployed.root) == before
    assert deploy(Options(port=deployed.port, board="rp2")).startswith("OK: RP2 board, ")


def test_a_micropython_that_is_too_old_is_refused_and_a_newer_one_is_mentioned(deployed, monkeypatch, capsys):
    before = contents(deployed.root)
    real = Mpremote.survey
    with monkeypatch.context() as patch:
        patch.setattr(Mpremote, "survey", lambda self: replace(real(self), version=(1, 19)))
        oldest = ".".join(map(str, MICROPYTHON.lowest))
        with pytest.raises(errors.DeployError, match=rf"1\.19: {oldest} or later.*nothing was changed"):
            deploy(Options(port=deployed.port, source=True))
    assert contents(deployed.root) == before
    monkeypatch.setattr(Mpremote, "survey", lambda self: replace(real(self), version=(2, 0)))
    deploy(Options(port=deployed.port))
    assert "MicroPython 2.0 is newer than any that was tried" in capsys.readouterr().err


FACTS = [["file", "main.py", "00", 7], ["listed", "main.py", "00"], ["aside", "main.py", ["main.py.bak", "11"]]]
FACTS += [["room", 9, 4096], ["about", None, "Pico", 1, 25]]


@pytest.mark.parametrize(
    "told", [[], ["file"], ["file", 7, "00", 7], ["aside", "main.py", 7], ["room", 1, 0], ["about", "x", "y", 1, 25], 7]
)
def test_what_a_board_tells_is_checked_before_anything_depends_on_it(monkeypatch, told):
    monkeypatch.setattr(Mpremote, "_tell", lambda *_: FACTS)
    aside = {"main.py": ["main.py.bak", "11"]}
    survey = Survey({"main.py": "00"}, {"main.py": 7}, {"main.py": "00"}, aside, 9, 4096, "Pico", (1, 25), None)
    assert Mpremote("COM4").survey() == survey
    monkeypatch.setattr(Mpremote, "_tell", lambda *_: [*FACTS, told])
    with pytest.raises(errors.DeployError, match="makes no sense: nothing was changed"):
        Mpremote("COM4").survey()


@pytest.mark.parametrize(
    "line", ["[" * 100_000, "9" * 5000, "{", "\x1b[2J"], ids=["deep", "5000 digits", "half", "odd"]
)
def test_what_a_board_tells_that_cannot_be_read_is_one_line(monkeypatch, line):
    monkeypatch.setattr(Mpremote, "_run", lambda self, *_, on_line, **__: on_line("@mirrormount " + line))
    with pytest.raises(errors.DeployError) as e:
        Mpremote("COM4").survey()
    assert str(e.value).isprintable()


@pytest.mark.full
@pytest.mark.parametrize("place", ["mountfw", "main.py"])
def test_a_file_that_arrives_damaged_changes_nothing(deployed, monkeypatch, place):
    before = contents(deployed.root)
    real = micropython.hashes
    wrong = "0" * 64
    damaged = {"mountfw": "mountfw/motion/axis.py", "main.py": "main.py"}[place]
    if place == "main.py":
        monkeypatch.setattr(
            micropython, "firmware", lambda _mpy: firmware(None) | {"main.py": b"import mountfw.start\n"}
        )
    monkeypatch.setattr(micropython, "hashes", lambda f: real(f) | ({damaged: wrong} if damaged in f else {}))
    with pytest.raises(errors.DeployError, match=f"damaged on the way: {place}.new.*the firmware that it had"):
        deploy(Options(port=deployed.port, source=True))
    assert contents(deployed.root) == before
    assert deployed.ask("VE?") == f"MM2 Version {mountfw.__version__} mirrormount"


@pytest.mark.full
def test_the_earlier_firmware_stays_beside_the_new_one_until_the_next_deploy(deployed):
    before = contents(deployed.root / "mountfw")
    assert deployed.deploy("--source").returncode == 0
    assert contents(deployed.root / "mountfw.old") == before
    assert deployed.deploy("--source").returncode == 0
    assert {path.name for path in deployed.root.iterdir()} == {"main.py", "mountfw"}


def test_a_board_whose_power_went_between_the_renames_starts_the_new_firmware(boot, deployed_files, tmp_path):
    root = Path(shutil.copytree(deployed_files, tmp_path / "cut"))
    (root / "mountfw").rename(root / "mountfw.new")
    board = boot(root)
    assert board.ask("VE?") == f"MM2 Version {mountfw.__version__} mirrormount"
    assert contents(root) == contents(deployed_files)


def of_0_2_0(files: Path, root: Path) -> dict[str, bytes]:
    """A board on which the main.py of 0.2.0 is: it has the start in it, and the folder has none. Returns its files."""
    shutil.copytree(files, root)
    (root / "mountfw" / "start.mpy").unlink()
    old = (PACKAGE.parent / "start.py").read_bytes()
    (root / "main.py").write_bytes(old)
    manifest = json.loads((root / "mountfw" / "manifest.json").read_text())
    del manifest["files"]["mountfw/start.mpy"]
    manifest["files"]["main.py"] = hashlib.sha256(old).hexdigest()
    (root / "mountfw" / "manifest.json").write_text(json.dumps(manifest))
    return contents(root)


def test_a_deploy_over_0_2_0_makes_the_board_one_of_now(boot, deployed_files, tmp_path):
    of_0_2_0(deployed_files, tmp_path / "old")
    board = boot(tmp_path / "old")
    done = board.deploy()
    assert done.returncode == 0, done.stderr
    assert contents(board.root / "mountfw") == contents(deployed_files / "mountfw")
    assert (board.root / "main.py").read_bytes() == (deployed_files / "main.py").read_bytes()


@pytest.mark.full
def test_0_2_0_starts_again_from_the_main_py_of_now_if_the_new_firmware_fails(
    boot, deployed_files, tmp_path, monkeypatch
):
    before = of_0_2_0(deployed_files, tmp_path / "old")
    board = boot(tmp_path / "old")
    files = firmware(None)
    files["mountfw/app.py"] = b"import no_such_module\n"
    monkeypatch.setattr(micropython, "firmware", lambda _mpy: files)
    with pytest.raises(errors.FirmwareFailed, match="that was there before is back and answers"):
        deploy(Options(port=board.port))
    after = contents(board.root)
    assert after.pop("main.py") == firmware(None)["main.py"]
    assert after.pop("mountfw/start.py") == before.pop("main.py")
    assert after == before


@pytest.mark.full
def test_a_deploy_that_was_killed_in_its_upload_leaves_no_more_files_than_the_next_one_can_tell(boot, tmp_path):
    root = tmp_path / "cut"
    parts = {path.replace("mountfw", "mountfw.new", 1): text for path, text in firmware(mpy_of_the_vm()).items()}
    for path, content in (parts | firmware(None)).items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_bytes(content)
    board = boot(root)
    assert board.ask("VE?")  # the firmware has run and left the memory in pieces
    done = board.deploy("--replace-main")
    assert done.returncode == 0, done.stderr
    assert not [path for path in contents(root) if ".new" in path]


@pytest.mark.full
def test_mip_installs_the_same_files(boot):
    board = boot()
    mip = [sys.executable, "-m", "mpremote", "connect", board.port, "resume", "mip", "install", "--target=/"]
    subprocess.run([*mip, str(PACKAGE), "+", "reset"], check=True, capture_output=True, timeout=600)
    assert contents(board.root) == firmware(None)
    assert board.ask("VE?") == f"MM2 Version {mountfw.__version__} mirrormount"


class Stranger:
    """A port where something else is: what it says to each thing that it hears."""

    lockstep = False

    def __init__(self, says: dict[bytes, bytes]) -> None:
        self.says = says
        self.heard = b""
        self.waiting = b""

    def read(self, timeout_s: float) -> bytes:
        data, self.waiting = self.waiting, b""
        return data

    def write(self, data: bytes) -> None:
        self.heard += data
        self.waiting += self.says.get(data, b"")

    def close(self) -> None:
        pass


@pytest.mark.parametrize(
    ("says", "expected"),
    [
        ({}, "no Python answers.*BOOTSEL.*mirrormount flash"),
        ({b"\x02": b"\r\nAdafruit CircuitPython 9.2.1 on 2024-11-20; Pico with rp2040\r\n>>> "}, "runs CircuitPython"),
        ({b"XS?\n": b"mirrormount: this board has a client already\r\n"}, "another program"),
        ({b"XS?\n": b"1,2,0|0,0,0,0,0,0|0,1,1,0,0,0\r\n"}, "a motor moves"),
    ],
    ids=["no Python", "CircuitPython", "taken", "moving"],
)
def test_what_cannot_be_deployed_to_is_told_and_hears_no_stop(monkeypatch, says, expected):
    port = Stranger(says)
    monkeypatch.setattr("mirrormount.deploy.micropython.open_port", lambda _address: port)
    with pytest.raises(errors.MountError, match=expected):
        deploy(Options(port="COM4"))
    assert b"!" not in port.heard


@pytest.mark.parametrize(
    ("machine", "says"),
    [
        ("cpython", "this virtual board has no MicroPython prompt: start it with --machine micropython"),
        ("circuitpython", "no MicroPython prompt comes at this port"),
    ],
)
def test_a_virtual_board_without_a_prompt_is_refused_and_goes_on(serve, machine, says):
    board = serve("--machine", machine)
    done = run_cli("deploy", str(board.link))
    assert done.returncode == 1 and says in done.stderr
    with Mount.open(str(board.link)) as mount:
        mount.x.step(1)


def test_without_a_board_deploy_says_how_a_new_one_gets_micropython(monkeypatch):
    monkeypatch.setattr("mirrormount.transport.discovery.find", list)
    with pytest.raises(errors.NoBoardFound, match="BOOTSEL"):
        deploy(Options())


@pytest.mark.parametrize(("typed", "replaced"), [("y\n", True), ("\n", False), ("", False)])
def test_on_a_terminal_one_is_asked_about_somebody_elses_main_py(monkeypatch, capsys, typed, replaced):
    terminal = io.StringIO(typed)
    terminal.isatty = lambda: True
    monkeypatch.setattr("sys.stdin", terminal)
    assert may_replace(Options())({"main.py": "main.py.bak"}) is replaced
    assert "copies stay as main.py.bak" in capsys.readouterr().err
