"""deploy and undeploy by drive. A folder stands in for the drive, and drive_board.py for the rest of the board."""

import errno
import json
import signal
from pathlib import Path

import pytest
from drive_board import (
    BROKEN,
    CONSOLE,
    DATA,
    FRESH,
    THEIRS,
    Board,
    contents,
    hash_on_board,
    make_drive,
    plug_in,
    stand_in_firmware,
)

from mirrormount import errors
from mirrormount.deploy import circuitpython
from mirrormount.deploy import firmware as firmware_files
from mirrormount.deploy.circuitpython import Files
from mirrormount.deploy.micropython import deploy, undeploy
from mirrormount.deploy.prompt import Options
from mirrormount.terminal import Terminated
from mirrormount.transport import discovery
from mirrormount.transport.discovery import Room

LIBRARY = {"lib/adafruit_motor/__init__.py": b"", "lib/adafruit_motor/motor.py": b"class DCMotor: ...\n"}


@pytest.fixture
def firmware(tmp_path, monkeypatch) -> Path:
    """The folder of a firmware with stand-ins for boot.py and code.py, and a stand-in for Adafruit's library."""
    folder = stand_in_firmware(tmp_path)
    monkeypatch.setattr(firmware_files, "package", lambda: folder)
    monkeypatch.setattr(circuitpython, "motor_library", lambda: dict(LIBRARY))
    return folder


@pytest.fixture
def board(tmp_path, monkeypatch, firmware) -> Board:
    """A board with a new drive, the only one that is plugged in."""
    board = Board(make_drive(tmp_path / "CIRCUITPY"), (firmware / "entry" / "code.py").read_bytes())
    plug_in(board, monkeypatch, back_s=0.1)
    monkeypatch.setattr(circuitpython, "_BY_HAND_S", 0.1)
    monkeypatch.setattr("mirrormount.deploy.prompt._ANSWER_S", 0.02)
    return board


@pytest.fixture
def deployed(board) -> Board:
    deploy(Options())
    board.heard, board.resets = b"", 0
    return board


def test_a_deploy_makes_a_new_drive_a_mount_and_the_board_tells_the_hash(board):
    said = deploy(Options())
    assert said.startswith("OK: Raspberry Pi Pico, mountfw 0.3.0, 2 axes, the board tells the hash of what was sent")
    assert board.running == hash_on_board(board.root)
    assert board.has_data


def test_a_drive_then_holds_the_firmware_the_motor_library_and_what_was_there(board):
    before = set(contents(board.root))
    deploy(Options())
    wanted = set(firmware_files.sources("circuitpython")) | set(LIBRARY) | {"mountfw/manifest.json"}
    assert set(contents(board.root)) == before | wanted
    assert contents(board.root)["settings.toml"] == b""


def test_no_file_of_micropython_goes_to_a_circuitpython_drive():
    names = set(firmware_files.sources("circuitpython"))
    assert "mountfw/app.py" in names and "mountfw/boards/pico.py" in names
    assert not [name for name in names if name.startswith("mountfw/ports/micropython") or "main.py" in name]


def test_of_the_installed_motor_library_the_part_for_dc_motors_is_taken_without_importing_it():
    import sys

    assert set(circuitpython.motor_library()) == set(LIBRARY)
    assert b"class DCMotor" in circuitpython.motor_library()["lib/adafruit_motor/motor.py"]
    assert "adafruit_motor" not in sys.modules


def test_without_the_motor_library_the_line_says_what_to_install(monkeypatch):
    monkeypatch.setattr(circuitpython.importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(errors.LibraryMissing, match=r"pip install .*\[circuitpython\]"):
        circuitpython.motor_library()


def test_nothing_changes_on_the_drive_while_a_program_runs(board, monkeypatch):
    at_prompt = []
    for name in ("write", "rename", "remove"):
        real = getattr(Files, name)

        def noted(self, *args, real=real):
            at_prompt.append(board.at_prompt)
            return real(self, *args)

        monkeypatch.setattr(Files, name, noted)
    deploy(Options())
    assert at_prompt and all(at_prompt)


def test_a_second_deploy_writes_nothing_and_does_not_restart_the_board(deployed, monkeypatch):
    monkeypatch.setattr(Files, "write", None)  # a write would fail loudly
    assert "(0 unchanged)" not in deploy(Options())
    assert deployed.resets == 0 and b"\x03" not in deployed.heard


def test_only_what_differs_is_written_and_what_is_no_more_goes(deployed, firmware, monkeypatch):
    (firmware / "motion" / "axis.py").write_text("# newer\n")
    (firmware / "sketch.py").write_text("")
    deploy(Options())
    (firmware / "sketch.py").unlink()
    written = []
    real = Files.write
    monkeypatch.setattr(Files, "write", lambda self, path, text: (written.append(path), real(self, path, text)))
    (firmware / "motion" / "axis.py").write_text("# newest\n")
    deploy(Options())
    assert [path for path in written if not path.endswith(".new")] == ["mountfw/motion/axis.py"]
    assert not (deployed.root / "mountfw" / "sketch.py").exists()
    assert deployed.running == hash_on_board(deployed.root)


def test_a_motor_that_moves_is_not_stopped_and_nothing_is_changed(deployed, firmware):
    (firmware / "motion" / "axis.py").write_text("# newer\n")
    before = contents(deployed.root)
    deployed.moving = True
    with pytest.raises(errors.DeployError, match="a motor moves"):
        deploy(Options())
    assert deployed.moving and contents(deployed.root) == before and b"\x03" not in deployed.heard


def test_told_to_stop_it_stops_the_motors_over_the_data_channel_first(deployed, firmware):
    (firmware / "motion" / "axis.py").write_text("# newer\n")
    deployed.moving = True
    deploy(Options(stop=True))
    assert deployed.heard.index(b"!\n") < deployed.heard.index(b"\x03")


def test_a_board_that_deploy_has_never_seen_hears_no_question_of_ours_before_its_prompt(board):
    deploy(Options())
    assert board.heard.startswith(b"\x03")


@pytest.mark.parametrize("name", ["code.py", "boot.py", "code.txt", "lib/adafruit_motor/motor.py"])
def test_a_file_of_somebody_else_stays_unless_one_says_so(board, name):
    (board.root / name).parent.mkdir(exist_ok=True)
    (board.root / name).write_bytes(THEIRS)
    before = contents(board.root)
    with pytest.raises(errors.DeployError, match=r"nothing was changed.*--replace-main"):
        deploy(Options())
    assert contents(board.root) == before


@pytest.mark.parametrize("name", ["code.py", "boot.py", "code.txt", "lib/adafruit_motor/motor.py"])
def test_replacing_it_keeps_a_copy_and_undeploy_gives_it_back(board, name):
    (board.root / name).parent.mkdir(exist_ok=True)
    (board.root / name).write_bytes(THEIRS)
    (board.root / f"{name}.bak").write_bytes(b"older")
    before = contents(board.root)
    assert f"{name} that was there is now {name}.bak2" in deploy(Options(replace_main=True))
    assert (board.root / f"{name}.bak2").read_bytes() == THEIRS
    assert f"there again: {name}" in undeploy(Options())
    before.pop("code.py") if name != "code.py" else None  # CircuitPython's own first program is nobody's
    assert contents(board.root) == before


def test_a_later_deploy_does_not_ask_again(board):
    (board.root / "code.py").write_bytes(THEIRS)
    deploy(Options(replace_main=True))
    deploy(Options())


def test_a_program_that_was_put_there_since_is_somebodys_again(deployed):
    (deployed.root / "code.py").write_bytes(THEIRS)
    with pytest.raises(errors.DeployError, match="somebody else"):
        deploy(Options())


def test_undeploy_leaves_what_the_user_has_put_there(deployed):
    theirs = {
        "notes.txt": "mine",
        "settings.toml": "A = 1",
        "lib/other.mpy": "x",
        "mountfw/boards/mine.py": "NAME = b''",
    }
    for name, text in theirs.items():
        (deployed.root / name).write_text(text)
    assert undeploy(Options()).startswith("OK: ")
    left = contents(deployed.root)
    left.pop("boot_out.txt")
    assert left == {name: text.encode() for name, text in theirs.items()}
    assert deployed.resets == 1


def test_undeploy_keeps_a_file_that_was_changed_since_and_says_so(deployed):
    (deployed.root / "code.py").write_bytes(THEIRS)
    assert "kept, because changed since: code.py" in undeploy(Options())
    assert (deployed.root / "code.py").read_bytes() == THEIRS


def test_undeploy_of_a_drive_that_was_not_deployed_to_removes_nothing(board):
    before = contents(board.root)
    with pytest.raises(errors.DeployError, match="nothing was removed"):
        undeploy(Options())
    assert contents(board.root) == before


def test_a_choice_of_a_board_stays_in_later_deploys(board):
    deploy(Options(board="pico_drv8833"))
    deploy(Options())
    assert contents(board.root)["mountfw/boards/this.py"] == b"from mountfw.boards.pico_drv8833 import *\n"


def test_a_board_of_somebody_else_in_the_folder_stays_and_counts_in_the_hash(deployed, firmware):
    (deployed.root / "mountfw" / "boards" / "mine.py").write_text("NAME = b'mine'\n")
    (firmware / "motion" / "axis.py").write_text("# newer\n")
    deploy(Options())
    assert (deployed.root / "mountfw" / "boards" / "mine.py").exists()
    assert deployed.running == hash_on_board(deployed.root)


@pytest.mark.parametrize("spare", [0, 200])
def test_a_full_drive_is_refused_before_anything_is_written_counted_in_clusters(board, monkeypatch, spare):
    wanted = firmware_files.sources("circuitpython") | LIBRARY
    clusters = sum(-(-len(text) // 512) for text in wanted.values())
    monkeypatch.setattr(discovery, "room", lambda _path: Room(clusters + spare - 1, 512, False))
    before = contents(board.root)
    if spare:
        deploy(Options())
        return
    with pytest.raises(errors.DriveFull, match=r"clusters of 512 bytes.*nothing was changed"):
        deploy(Options())
    assert contents(board.root) == before and not board.heard


def test_what_will_be_replaced_counts_as_room(deployed, firmware, monkeypatch):
    file = firmware / "motion" / "axis.py"
    big = file.read_bytes() + b"#" * 10_000
    file.write_bytes(big)
    deploy(Options())
    file.write_bytes(b"#" + big[1:])
    monkeypatch.setattr(discovery, "room", lambda _path: Room(40, 512, False))  # less than the file has
    deploy(Options())
    assert len(big) > 40 * 512


def test_a_read_only_drive_is_refused_with_the_remedy(board, monkeypatch):
    monkeypatch.setattr(discovery, "room", lambda _path: Room(10_000, 512, True))
    with pytest.raises(errors.DriveReadOnly, match=r"safe mode.*nothing was changed"):
        deploy(Options())
    assert not board.heard


@pytest.mark.parametrize(
    ("number", "error", "says"),
    [
        (errno.ENOSPC, errors.DriveFull, "full; nothing runs"),
        (errno.EROFS, errors.DriveReadOnly, "nothing runs"),
        (errno.EIO, errors.DriveFailed, "has gone .*nothing runs"),
    ],
)
def test_a_drive_that_fails_in_the_middle_leaves_a_board_that_does_nothing(
    deployed, firmware, monkeypatch, number, error, says
):
    (firmware / "motion" / "axis.py").write_text("# newer\n")
    (firmware / "zoom.py").write_text("")
    real = Files.write

    def write(self, path, content):
        if path == "mountfw/zoom.py":
            raise OSError(number, "injected")
        real(self, path, content)

    monkeypatch.setattr(Files, "write", write)
    with pytest.raises(error, match=says):
        deploy(Options())
    assert deployed.running == "" and (deployed.root / "code.py").read_bytes() == circuitpython.STUB
    monkeypatch.undo()


def test_a_drive_that_fails_before_the_firmware_is_touched_leaves_it_running(deployed, firmware, monkeypatch):
    (firmware / "motion" / "axis.py").write_text("# newer\n")
    before = contents(deployed.root)

    def write(self, path, content):
        raise OSError(errno.ENOSPC, "injected")

    monkeypatch.setattr(Files, "write", write)
    with pytest.raises(errors.DriveFull, match="nothing of the firmware was changed"):
        deploy(Options())
    assert contents(deployed.root) == before and deployed.running


def end_when_it_hears(board: Board, monkeypatch, data: bytes, times: int, end: BaseException) -> None:
    """Once, the command is ended right after the board has received this data for the n-th time."""
    heard: list[bytes] = []
    real = board.hear

    def hear(address: str, received: bytes) -> bytes:
        answer = real(address, received)
        if data in received:
            heard.append(received)
            if len(heard) == times:
                raise end
        return answer

    monkeypatch.setattr(board, "hear", hear)


@pytest.mark.parametrize("end", [KeyboardInterrupt(), Terminated(signal.SIGTERM)])
@pytest.mark.parametrize("command", [deploy, undeploy])
@pytest.mark.parametrize("data", [b"\x03", b"import microcontroller"])
def test_a_command_that_is_ended_at_the_prompt_restarts_the_board(deployed, firmware, monkeypatch, command, data, end):
    (firmware / "zoom.py").write_text("")
    end_when_it_hears(deployed, monkeypatch, data, 1, end)
    with pytest.raises(type(end)):
        command(Options())
    assert deployed.resets == 1 and not deployed.at_prompt


def test_a_deploy_that_is_ended_after_the_new_firmware_failed_restarts_the_board(board, firmware, monkeypatch):
    break_it(firmware)
    end_when_it_hears(board, monkeypatch, b"\x03", 3, KeyboardInterrupt())  # approach, restart, for its last words
    with pytest.raises(KeyboardInterrupt):
        deploy(Options())
    assert board.resets == 2 and not board.at_prompt


def test_a_drive_that_cannot_be_read_leaves_the_firmware_running(deployed, monkeypatch):
    def read(self, path):
        raise OSError(errno.EIO, "injected")

    monkeypatch.setattr(Files, "read", read)
    with pytest.raises(errors.DriveFailed, match="nothing was changed"):
        deploy(Options())
    assert deployed.running


@pytest.mark.parametrize("text", ["", "{", "[]", '{"files": 7}', '{"files": {}, "aside": {"code.py": 7}}'])
def test_a_manifest_that_is_damaged_does_not_count(deployed, text):
    (deployed.root / "mountfw" / "manifest.json").write_text(text)
    with pytest.raises(errors.DeployError, match="nothing was removed"):
        undeploy(Options())
    assert deploy(Options(replace_main=True)).startswith("OK: ")


def test_what_is_read_back_differently_is_told(board, monkeypatch):
    real = Files.write

    def damaged(self, path, content):
        real(self, path, content[:-1] if path == "mountfw/motion/axis.py" else content)

    monkeypatch.setattr(Files, "write", damaged)
    with pytest.raises(errors.DriveFailed, match=r"mountfw/motion/axis\.py is not on the drive as it was sent"):
        deploy(Options())


def test_a_board_that_runs_something_else_afterwards_is_told(board, monkeypatch):
    monkeypatch.setattr("drive_board.hash_on_board", lambda _root: "0" * 64)
    with pytest.raises(errors.NotSeenRunning, match="is not what was sent"):
        deploy(Options())


def break_it(firmware: Path) -> None:
    """The firmware that deploy has is one that fails."""
    (firmware / "app.py").write_bytes(BROKEN)


def test_of_a_new_firmware_that_fails_the_last_line_is_told_and_the_next_deploy_mends_it(board, firmware):
    good = (firmware / "app.py").read_bytes()
    break_it(firmware)
    with pytest.raises(errors.FirmwareFailed, match="RuntimeError: broken; the new files are on the drive: deploy"):
        deploy(Options())
    assert not board.running
    (firmware / "app.py").write_bytes(good)
    assert deploy(Options()).startswith("OK: ")


def test_a_board_without_a_board_file_is_named_before_anything_is_written(board):
    text = (board.root / "boot_out.txt").read_text()
    (board.root / "boot_out.txt").write_text(text.replace("raspberry_pi_pico", "odd_board"))
    before = contents(board.root)
    with pytest.raises(errors.DeployError, match=r"no board file for a 'odd_board'.*--board \(.*--pins FILE"):
        deploy(Options(port=CONSOLE))
    assert contents(board.root) == before and not board.heard
    assert deploy(Options(port=CONSOLE, board="rp2")).startswith("OK: ")


def test_a_newer_circuitpython_than_any_that_was_tried_is_mentioned(board, capsys):
    text = (board.root / "boot_out.txt").read_text()
    (board.root / "boot_out.txt").write_text(text.replace("9.2.1", "99.1.0"))
    deploy(Options())
    assert "CircuitPython 99.1.0 is newer than any that was tried" in capsys.readouterr().err


def test_without_a_console_the_user_is_asked_to_press_reset_and_the_line_says_what_was_not_seen(board, capsys):
    board.with_console = False
    with pytest.raises(errors.NotSeenRunning, match=r"read back as sent.*no port of it was seen"):
        deploy(Options())
    assert "press its reset button now" in capsys.readouterr().err
    board.with_console = True
    board.start()
    assert "the board tells the hash of what was sent" in deploy(Options())


def test_a_board_with_one_channel_answers_on_its_console(board):
    board.one_channel = True
    assert deploy(Options()).startswith("OK: ")
    assert not board.has_data


def test_a_running_firmware_whose_port_is_busy_is_left_alone(deployed, firmware, monkeypatch):
    (firmware / "motion" / "axis.py").write_text("# newer\n")
    before = contents(deployed.root)

    def busy(address, **_):
        raise errors.PortBusy(f"{address}: another program has this port open")

    monkeypatch.setattr(circuitpython, "open_port", busy)
    with pytest.raises(errors.PortBusy, match=DATA):
        deploy(Options())
    assert contents(deployed.root) == before


def test_the_manifest_lists_what_was_put_there(deployed):
    told = json.loads(contents(deployed.root)["mountfw/manifest.json"])
    assert set(told["files"]) == set(firmware_files.sources("circuitpython")) | set(LIBRARY)
    assert "unfinished" not in told


def test_circuitpythons_own_first_program_is_replaced_without_a_question(board):
    assert (board.root / "code.py").read_bytes() == FRESH
    deploy(Options())
    assert not (board.root / "code.py.bak").exists()
