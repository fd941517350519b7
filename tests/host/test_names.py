"""Names of mounts in table.toml: what a port's place may be, where the board is, and what is refused."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from served import run_cli

import mirrormount.transport.discovery
from mirrormount import errors
from mirrormount.cli import main
from mirrormount.device import table_file
from mirrormount.device.mount import Mount
from mirrormount.device.table_file import CameraEntry, MountEntry, TableFile

BOARD = "e6616408432f5a21"


@pytest.fixture
def table(tmp_path, monkeypatch) -> Path:
    """A file of names that does not exist yet."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))
    monkeypatch.delenv("MIRRORMOUNT_TABLE", raising=False)
    return tmp_path / "table.toml"


@pytest.fixture
def plugged(monkeypatch) -> None:
    """One board is plugged in, which nobody may open."""
    port = SimpleNamespace(device="/dev/ttyACM7", vid=0x2E8A, pid=5, serial_number=BOARD.upper())
    monkeypatch.setattr(mirrormount.transport.discovery.list_ports, "comports", lambda: [port])


def test_a_mount_is_opened_by_its_name_with_its_axis_of_x(table):
    table.write_text('[mounts.far]\nport = "virtual://?speed=max"\nx_axis = 1\n')
    with Mount.open("far") as mount:
        assert (mount.x.number, mount.y.number) == (1, 2)
    with Mount.open("far", x_axis=2) as mount:
        assert mount.x.number == 2


def test_every_command_takes_the_name(table):
    table.write_text('[mounts.far]\nport = "virtual://?speed=max"\n')
    assert run_cli("step", "x", "2", "--port", "far").stdout == "x: moved +2 steps, now at +2 (unknown)\n"


def test_another_file_may_be_named_before_or_behind_the_command(table):
    (other := table.with_name("other.toml")).write_text('[mounts.far]\nport = "virtual://?speed=max"\n')
    for words in (
        ("--table", str(other), "status", "--port", "far"),
        ("status", "--port", "far", "--table", str(other)),
    ):
        assert "x: +0.000 steps" in run_cli(*words).stdout


def test_a_board_is_found_by_its_id_wherever_it_is_plugged_in(table, plugged):
    table.write_text(f'[mounts.near]\nboard = "{BOARD}"\n[mounts.far]\nboard = "e000000000000000"\n')
    assert table_file.find_port("near")[:2] == ("/dev/ttyACM7", 2)
    with pytest.raises(errors.NoBoardFound, match=r"far: the board e0+ is not plugged in \(there: /dev/ttyACM7\)"):
        table_file.find_port("far")
    assert table_file.table_addresses() == ["/dev/ttyACM7"]


def test_a_name_that_the_table_lacks_is_told_with_those_that_it_has(table):
    table.write_text('[mounts.near]\nport = "virtual://"\n')
    with pytest.raises(errors.BadAddress, match=r"nare is no port, and no mount of .*: that has near"):
        table_file.find_port("nare")


def test_ports_and_files_are_no_names(table):
    table.write_text("this is read by nobody")
    for address in ("/dev/ttyACM0", "COM4", "com12", "socket://h:1", "virtual://", "", "1", str(table)):
        assert table_file.find_port(address)[:2] == (address, None)


def test_what_is_written_is_read(table):
    written = TableFile(
        {"near": MountEntry(board=BOARD), "far": MountEntry(port="virtual://", x_axis=4, distance_mm=600.0)},
        {"one": CameraEntry("0", 400.0, 320.0, 240.5), "two": CameraEntry("Logitech C270")},
    )
    assert table_file.write(written) == table
    read = table_file.read()
    assert read == written and list(read.mounts) == ["near", "far"]
    assert read.cameras["one"].target_px == (320.0, 240.5) and read.cameras["two"].target_px is None


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('[mount.near]\nport = "x"', "mount.*not known"),
        ('[mounts."a b"]\nport = "x"', "a name is a letter"),
        ('[mounts.com3]\nport = "x"', "no COM port"),
        ("mounts = 3", "at most 64 tables"),
        ("[mounts]\nnear = 3", "not a table"),
        ("[mounts.near]\n", "one of them"),
        ('[mounts.near]\nport = "x"\nboard = "y"', "one of them"),
        ('[mounts.near]\nport = "x"\nx_axis = 5', "1 to 4"),
        ('[mounts.near]\nport = "x"\nx_axis = true', "1 to 4"),
        ('[mounts.near]\nport = "x"\ndistance_mm = -1', "above 0"),
        ('[mounts.near]\nport = "x"\ndistance_mm = nan', "above 0"),
        ('[mounts.near]\nport = "x"\nspeed = 1', "speed is not known"),
        ("[mounts.near]\nport = 3", "a text in quotes"),
        (
            '[mounts.near]\nboard = "ab"\n[mounts.far]\nboard = "AB"',
            r"far\] is the same board and pair .*1 and 2.* as near",
        ),
        (
            '[mounts.near]\nport = "x"\nx_axis = 3\n[mounts.far]\nport = "x"\nx_axis = 4',
            r"far\] is the same board and pair of axes \(3 and 4\) as near: .* x_axis = 1 or 2 to the one",
        ),
        ('[mounts.near]\nport = "x"\n[cameras.near]\ncamera = "0"', "near is a mount and a camera: give one"),
        ('[cameras.near]\ncamera = "C270"\n[cameras.far]\ncamera = "c270"', r"far\] is the same camera as near: give"),
        ("[cameras.near]\n", "camera is missing"),
        ('[cameras.near]\ncamera = "0"\ntarget_x_px = 3', "both"),
        ('[cameras.near]\ncamera = "0"\ntarget_x_px = -3\ntarget_y_px = 1', "from 0"),
        ('[cameras.near]\ncamera = "0"\ntarget_x_px = "3"\ntarget_y_px = 1', "a number"),
    ],
)
def test_a_wrong_entry_is_one_line_that_names_its_place(table, text, why):
    table.write_text(text)
    with pytest.raises(errors.BadFile, match=why) as e:
        table_file.read()
    assert str(table) in str(e.value) and "\n" not in str(e.value)


def test_a_named_file_that_is_missing_is_no_empty_table(table, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_TABLE", str(table))
    with pytest.raises(errors.BadFile, match="no such file"):
        table_file.read()


def test_an_empty_variable_names_no_file(table, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_TABLE", "")
    assert table_file.read() == TableFile()


def test_a_folder_that_is_named_as_the_file_is_told_from_a_missing_one(tmp_path, table, capsys, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_TABLE", str(tmp_path))
    assert main.main(["table"]) == 1
    assert capsys.readouterr().err == f"mirrormount: {tmp_path}: a folder or a device is there, no file of a table\n"


def test_stop_takes_a_name_and_without_one_goes_to_every_mount_of_the_table(table, serve):
    boards = [serve(), serve()]
    table.write_text("".join(f'[mounts.m{i}]\nport = "{board.link}"\n' for i, board in enumerate(boards)))
    assert run_cli("stop", "--port", "m1").stdout == "stopped\n"
    run = run_cli("stop")
    assert run.returncode == 0, run.stderr
    assert sorted(run.stdout.splitlines()) == sorted(f"{board.link}: stopped" for board in boards)


def test_names_are_given_listed_and_removed_in_the_shell(table, plugged, capsys):
    def run(*words: str) -> tuple[int, str]:
        status = main.main(["table", *words])
        return status, "".join(capsys.readouterr())

    assert run() == (0, f"{table}\nno names yet: mirrormount table mount NAME, mirrormount table camera NAME CAMERA\n")
    assert "no scale of axis 1, axis 2 yet" in run("mount", "near")[1]
    run("mount", "far", "socket://127.0.0.1:5023", "--x-axis", "1", "--distance", "600")
    run("camera", "screen", "virtual-table://", "--target", "320", "240.5")
    run("camera", "screen", "--distance", "400")
    assert table_file.read() == TableFile(
        {"near": MountEntry(board=BOARD), "far": MountEntry(port="socket://127.0.0.1:5023", x_axis=1, distance_mm=600)},
        {"screen": CameraEntry("virtual-table://", 400.0, 320.0, 240.5)},
    )
    status, listed = run("list")
    assert status == 0 and "near: /dev/ttyACM7, board" in listed and "target 320, 240.5 px, 400 mm behind" in listed
    run("remove", "near")
    assert list(table_file.read().mounts) == ["far"]


def test_a_board_that_is_not_there_is_told_and_the_status_is_1(table, plugged, capsys):
    table.write_text('[mounts.far]\nboard = "e000000000000000"\n')
    assert main.main(["table"]) == 1
    assert "far: NOT PLUGGED IN" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("mount", "com4", "/dev/x"), "no COM port"),
        (("mount", "near", "--x-axis", "5"), "1 to 4"),
        (("mount", "near", "--x-axis", "two"), "whole number"),
        (("mount", "near", "--distance", "0"), "above 0"),
        (("mount", "again", "/dev/ttyACM7"), "first is that mount already"),
        (("mount", "screen"), "name of a camera already"),
        (("camera", "first", "0"), "name of a mount already"),
        (("camera", "new"), "which camera"),
        (("camera", "new", "0", "--target", "-1", "2"), "from 0"),
        (("camera", "new", "0", "--target", "a", "2"), "a number"),
        (("remove", "new"), "no name of"),
    ],
)
def test_a_wrong_word_is_one_line_and_the_file_stays(table, plugged, capsys, words, why):
    table.write_text(before := f'[mounts.first]\nboard = "{BOARD}"\n[cameras.screen]\ncamera = "0"\n')
    assert main.main(["table", *words]) == 1
    told = capsys.readouterr().err
    assert why in told and told.count("\n") == 1
    assert table.read_text() == before


def test_a_port_of_a_path_is_known_in_every_folder_and_told_when_it_is_not_there(table, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main.main(["table", "mount", "near", "./mount"]) == 0
    assert table_file.read().mounts["near"].port == str(tmp_path / "mount")
    assert main.main(["table"]) == 1
    assert f"near: {tmp_path / 'mount'} NOT THERE" in capsys.readouterr().out
