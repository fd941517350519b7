"""A drive that somebody has prepared: it reads and writes nothing of this computer, and no other device.

The drive is a folder beside `secret`, which stands for the user's own files.
"""

import json
import os
from pathlib import Path
from types import SimpleNamespace

import pytest
from drive_board import BOOT_OUT, CONSOLE, DATA, THEIRS, UID, Board, contents, make_drive, plug_in, stand_in_firmware

import mirrormount.transport.find
import mirrormount.transport.open
from mirrormount.cli import main
from mirrormount.common import errors
from mirrormount.deploy import circuitpython, fileset
from mirrormount.deploy.circuitpython_plan import read_manifest
from mirrormount.deploy.handshake import Options
from mirrormount.deploy.micropython import choose, deploy, undeploy
from mirrormount.transport import circuitpy_files, circuitpy_ports, volumes
from mirrormount.transport.circuitpy_drives import Drive, drive_at
from mirrormount.transport.circuitpy_files import Files, is_path
from mirrormount.transport.circuitpy_ports import Channels, channels, unproven

SECRET = b"a private key\n"
SHA = "0" * 64
HOSTILE_TEXT = "\x1b]0;title\x07\x1b[2Jmine\x9b31m"


@pytest.fixture
def board(tmp_path, monkeypatch) -> Board:
    firmware = stand_in_firmware(tmp_path)
    monkeypatch.setattr(fileset, "package", lambda: firmware)
    monkeypatch.setattr(
        circuitpython, "motor_library", lambda: {"lib/adafruit_motor/motor.py": b"class DCMotor: ...\n"}
    )
    board = Board(make_drive(tmp_path / "CIRCUITPY"), (firmware / "entry" / "code.py").read_bytes())
    plug_in(board, monkeypatch, back_s=0.1)
    monkeypatch.setattr("mirrormount.deploy.handshake._ANSWER_S", 0.02)
    return board


@pytest.fixture
def secret(tmp_path) -> Path:
    """The user's folder, with a file in it."""
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "app.py").write_bytes(SECRET)
    return tmp_path / "secret"


@pytest.fixture(params=[True, False], ids=["by descriptor", "by path, as on Windows"])
def way(request, monkeypatch) -> None:
    monkeypatch.setattr(circuitpy_files, "_RELATIVE_TO_FOLDERS", request.param)


def assert_nothing_got_out(board: Board, secret: Path) -> None:
    assert contents(secret) == {"app.py": SECRET}
    plain = [path for path in board.root.rglob("*") if path.is_file() and path.resolve().is_relative_to(board.root)]
    assert not [path for path in plain if path.stat().st_nlink == 1 and path.read_bytes() == SECRET]


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize(
    "place",
    [
        "code.py",
        "boot.py",
        "code.txt",
        "code.py.new",
        "mountfw/app.py",
        "mountfw/new.py",
        "mountfw/manifest.json",
        "mountfw/boards/this.py",
        "lib/adafruit_motor/motor.py",
    ],
)
def test_a_link_to_a_file_is_neither_read_nor_written(board, secret, place):
    (board.root / place).parent.mkdir(parents=True, exist_ok=True)
    (board.root / place).unlink(missing_ok=True)
    (board.root / place).symlink_to(secret / "app.py")
    for action in (deploy, undeploy):
        with pytest.raises(errors.WrongDrive, match="is a link or no plain file"):
            action(Options(replace_main=True))
    assert_nothing_got_out(board, secret)


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("place", ["mountfw", "mountfw/boards", "lib", "lib/adafruit_motor"])
def test_a_link_to_a_folder_is_not_followed(board, secret, place):
    (board.root / place).parent.mkdir(exist_ok=True)
    if place == "lib":
        (board.root / "lib").rmdir()
    (board.root / place).symlink_to(secret)
    with pytest.raises(errors.WrongDrive, match="is a link or no plain file"):
        deploy(Options(replace_main=True))
    assert_nothing_got_out(board, secret)


@pytest.mark.usefixtures("way")
def test_a_second_name_of_a_file_elsewhere_is_not_one_of_the_drive(board, secret):
    (board.root / "code.py").unlink()
    os.link(secret / "app.py", board.root / "code.py")
    with pytest.raises(errors.WrongDrive, match="is a link or no plain file"):
        deploy(Options(replace_main=True))
    assert_nothing_got_out(board, secret)


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("place", ["boot_out.txt", "code.py", "mountfw/app.py"])
def test_a_pipe_in_place_of_a_file_is_refused_and_not_waited_for(board, place):
    (board.root / "mountfw").mkdir()
    (board.root / place).unlink(missing_ok=True)
    os.mkfifo(board.root / place)
    with pytest.raises(errors.WrongDrive):
        deploy(Options(drive=board.root))


def test_files_that_no_flash_has_room_for_are_not_all_taken_into_memory(board, monkeypatch):
    (board.root / "mountfw").mkdir()
    for name in "abc":
        (board.root / "mountfw" / f"{name}.py").write_bytes(b"#" * 500_000)
    monkeypatch.setattr(circuitpy_files, "_MOST_BYTES", 1_000_000)
    with pytest.raises(errors.WrongDrive, match="more than a board's flash"):
        deploy(Options(drive=board.root))


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("operation", ["read", "write", "remove", "rename", "renamed to", "make_folder", "exists"])
@pytest.mark.parametrize("path", ["../secret/app.py", "mountfw/../../secret/app.py", "/etc/passwd", "link/app.py"])
def test_no_operation_leaves_the_drive(board, secret, operation, path):
    (board.root / "link").symlink_to(secret)
    files = Files(board.root)
    arguments = {"write": (path, b"new"), "rename": (path, "x.py"), "renamed to": ("code.py", path)}
    with pytest.raises(errors.WrongDrive):
        getattr(files, operation.removesuffix("d to"))(*arguments.get(operation, (path,)))
    assert_nothing_got_out(board, secret)


@pytest.mark.parametrize(
    "path",
    [
        *("", ".", "..", "a/../b", "/a", "a//b", "a/", "C:/a", "C:a", "a\\b", "..\\a", "a" * 256, 7, None),
        *("nul", "mountfw/CON.py", "com1.txt", "LPT9", "a.", "a ", "a/b. ", "a?", "a*", 'a"'),
        *("a\n", "a\x00", "a\x1b[m", "a\u202eb"),
    ],
)
def test_what_is_no_path_on_a_drive(path):
    assert not is_path(path)


def test_what_is_one():
    assert all(map(is_path, ("code.py", "mountfw/boards/this.py", "._code.py", "a b/µ.py", "console.py", "com10.py")))


@pytest.mark.parametrize(
    "told",
    [
        {"files": {"../secret/app.py": SHA}},
        {"files": {"/etc/passwd": SHA}},
        {"files": {"notes.txt": SHA}},
        {"files": {"mountfw/../../secret/app.py": SHA}},
        {"files": {"C:\\a": SHA}},
        {"files": {"mountfw/app.py": "not a hash"}},
        {"files": {}, "aside": {"code.py": ["../secret/app.py", SHA]}},
        {"files": {}, "aside": {"code.py": ["notes.txt", SHA]}},
        {"files": {}, "aside": {"../secret/app.py": ["../secret/app.py.bak", SHA]}},
        {"files": {}, "aside": {"code.py": ["code.py.bak/../x", SHA]}},
        {"files": {}, "unfinished": {"../secret/app.py": SHA}},
        {"files": 7},
        {"files": []},
        {"files": {"code.py": 7}},
        {"files": {}, "aside": 7},
        {"files": {}, "aside": {"code.py": 7}},
        {"files": {}, "aside": {"code.py": ["a", "b", "c"]}},
        {"files": {}, "aside": {"code.py": ["code.py.bak", None]}},
        {"files": {}, "unfinished": 7},
        [],
        7,
        None,
    ],
    ids=json.dumps,
)
def test_a_manifest_that_no_deploy_has_written_does_not_count(told):
    read = read_manifest(json.dumps(told).encode())
    assert (read.files, read.aside, read.unfinished) == ({}, {}, None)
    assert read.damage.isprintable() and 0 < len(read.damage) <= 100


@pytest.mark.parametrize(
    "text",
    [
        b"[" * 100_000,
        b'{"files":' * 100_000,
        b'{"files": ' + b"9" * 5000 + b"}",
        b"\xff\xfe",
        b'{"files": {"\\u001b[2J": "0"}}',
        b"{",
        b'{"files": {}, "files": 1e999}',
    ],
    ids=["deep list", "deep object", "5000 digits", "no text", "escapes", "half", "infinite"],
)
def test_an_odd_manifest_is_one_line_and_no_traceback(board, capsys, text):
    (board.root / "mountfw").mkdir()
    (board.root / "mountfw" / "manifest.json").write_bytes(text)
    assert main.main(["undeploy", "--drive", str(board.root)]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "nothing was removed" in said and said.strip().isprintable()
    assert main.main(["deploy", "--drive", str(board.root)]) == 0
    assert "is not as deploy writes it" in capsys.readouterr().err
    assert board.running


def test_a_copy_that_a_manifest_names_elsewhere_is_not_moved_onto_the_drive(board, secret):
    deploy(Options())
    place = board.root / "mountfw" / "manifest.json"
    told = json.loads(place.read_text())
    told["aside"] = {"code.py": ["../secret/app.py", SHA]}
    place.write_text(json.dumps(told))
    with pytest.raises(errors.DeployError, match="nothing was removed"):
        undeploy(Options())
    assert_nothing_got_out(board, secret)


def test_escape_sequences_of_a_drive_do_not_reach_the_terminal(board, capsys):
    text = BOOT_OUT.format(version="9.2.1").replace("Raspberry Pi Pico with", HOSTILE_TEXT)
    (board.root / "boot_out.txt").write_text(text)
    (board.root / "code.py").write_bytes(THEIRS)
    for command in (["deploy"], ["undeploy"], ["deploy", "--replace-main"], ["ports"]):
        main.main(command)
        out, err = capsys.readouterr()
        assert all(line.isprintable() for line in (out + err).splitlines()), command
    assert r"\x1b[2Jmine" in out


def test_escape_sequences_of_a_board_do_not_reach_the_terminal(board, monkeypatch, capsys):
    real = Board.firmware
    monkeypatch.setattr(
        Board, "firmware", lambda self, data: real(self, data).replace(b"Raspberry Pi Pico", b"\x1b[2J\x9b31m")
    )
    assert main.main(["deploy"]) == 0
    out, err = capsys.readouterr()
    assert r"\x1b[2J" in out and all(line.isprintable() for line in (out + err).splitlines())


# ---- whose port is it?


def stranger(serial: str = UID, **more) -> SimpleNamespace:
    """An instrument with that serial number."""
    ids = {"vid": 0x0403, "pid": 0x6001}
    return SimpleNamespace(
        device="/dev/ttyUSB0", location="1-9:1.0", interface="", serial_number=serial, **(ids | more)
    )


@pytest.fixture
def instrument(board, monkeypatch) -> SimpleNamespace:
    """Beside the drive, which tells its serial number, an instrument alone is plugged in. Opening it would fail."""
    port = stranger()
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [port])
    monkeypatch.setattr(circuitpython, "open_port", None)
    monkeypatch.setattr(mirrormount.transport.open, "SerialPort", None)
    return port


@pytest.mark.usefixtures("instrument")
def test_a_drive_with_an_instruments_serial_number_has_nothing_sent_there(board):
    (board.root / "mountfw").mkdir()
    for action in (deploy, undeploy):
        with pytest.raises(errors.WrongDrive, match=r"says that /dev/ttyUSB0 is its board's.*nothing was sent"):
            action(Options())
    assert mirrormount.transport.find.find() == []


def test_a_person_can_vouch_for_a_port_by_naming_it(board, instrument):
    drive = Drive(board.root, "9.2.1", "x", "", UID)
    assert channels(drive, [instrument]) == Channels()
    assert unproven(drive, [instrument]) == [instrument.device]
    for options in (Options(port=instrument.device), Options(port=instrument.device, drive=board.root)):
        assert channels(choose(options), [instrument]).console == instrument.device


def test_a_named_port_and_a_named_drive_of_two_boards_are_refused(board, instrument):
    instrument.serial_number = "OTHER"
    with pytest.raises(errors.WrongDrive, match="not of one board"):
        deploy(Options(port=instrument.device, drive=board.root))


def test_two_drives_with_one_uid_are_both_refused(board, monkeypatch, tmp_path):
    copy = make_drive(tmp_path / "copy")
    monkeypatch.setattr(volumes, "mounted", lambda: [board.root, copy])
    for root in (board.root, copy):
        (root / "mountfw").mkdir()
        with pytest.raises(errors.WrongDrive, match="has the same UID"):
            deploy(Options(drive=root))
    assert mirrormount.transport.find.find() == []
    assert board.heard == b""


@pytest.mark.parametrize("same", [True, False])
def test_where_the_system_lists_both_they_are_one_usb_device_or_they_are_not(board, monkeypatch, tmp_path, same):
    number = os.stat(board.root).st_dev
    for name in ("1-2", "1-3"):
        (tmp_path / "sys" / "usb1" / name / "host0" / "sda").mkdir(parents=True)
    listed = tmp_path / "sys" / "dev" / "block" / f"{os.major(number)}:{os.minor(number)}"
    listed.parent.mkdir(parents=True)
    listed.symlink_to(tmp_path / "sys" / "usb1" / "1-2" / "host0" / "sda")
    monkeypatch.setattr(circuitpy_ports, "_SYSFS", str(tmp_path / "sys"))
    usb_device = str(tmp_path / "sys" / "usb1" / ("1-2" if same else "1-3"))
    ports = [stranger(usb_device_path=usb_device)]
    assert channels(drive_at(board.root), ports) == Channels(console="/dev/ttyUSB0" if same else None)
    assert unproven(drive_at(board.root), ports) == []


def test_where_it_does_not_the_usb_ids_of_circuitpython_on_that_board_count(board):
    (console,) = board.ports()
    data = SimpleNamespace(**vars(console) | {"device": DATA})
    assert channels(drive_at(board.root), [console, data]).console == CONSOLE
    console.pid = data.pid = 0x80F2  # of another board
    assert channels(drive_at(board.root), [console, data]) == Channels()
