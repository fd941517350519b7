"""Finding CircuitPython boards: their drives on three systems, and which serial ports are theirs. No port is opened."""

import ctypes
from pathlib import Path
from types import SimpleNamespace

import pytest
from drive_board import BOOT_OUT, UID, make_drive, usb_port

import mirrormount.transport.discovery
import mirrormount.transport.ports
from mirrormount import errors
from mirrormount.cli import main
from mirrormount.deploy import micropython
from mirrormount.deploy.micropython import choose
from mirrormount.deploy.prompt import Options
from mirrormount.transport import discovery
from mirrormount.transport.discovery import Channels, Drive, channels, check_version, drive_at

PICO = Drive(Path("/media/me/CIRCUITPY"), "9.2.1", "Raspberry Pi Pico with rp2040", "raspberry_pi_pico", UID)
MICROPYTHON = SimpleNamespace(
    device="/dev/ttyACM9", vid=0x2E8A, pid=5, serial_number="e660", location="1-4:1.0", interface="Board CDC"
)
CONTROL, DATA = "CircuitPython CDC control", "CircuitPython CDC2 control"
# what pyserial 3.5 tells on each system of the console and the data channel of one board
SYSTEMS = {
    "Linux": [usb_port("/dev/ttyACM1", "1-2:1.0", CONTROL), usb_port("/dev/ttyACM0", "1-2:1.2", DATA)],
    "Windows": [usb_port("COM11", "1-2:x.0", None), usb_port("COM4", "1-2:x.2", None)],
    "macOS": [usb_port("/dev/cu.usbmodem9801", "20-1", DATA), usb_port("/dev/cu.usbmodem9803", "20-1", DATA)],
    "a later macOS": [usb_port("/dev/cu.usbmodem1101", "1-1", None), usb_port("/dev/cu.usbmodem1103", "1-1", None)],
}
STRANGERS = [
    usb_port("/dev/ttyACM7", "1-7:1.0", CONTROL, serial="OTHER"),
    usb_port("/dev/ttyACM8", "1-7:1.2", DATA, serial="OTHER"),
    SimpleNamespace(device="/dev/ttyS0", vid=None, pid=None, serial_number=None, location=None, interface=None),
]


@pytest.fixture
def plugged(tmp_path, monkeypatch):
    """Drives (by name) and ports that are there; returns the drives' roots."""

    def plug(names: list[str], ports: list) -> list[Path]:
        roots = [make_drive(tmp_path / name) for name in names]
        monkeypatch.setattr(discovery, "mounted", lambda: roots)
        monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)
        monkeypatch.setattr(mirrormount.transport.ports, "SerialPort", None)  # opening anything would fail loudly
        return roots

    return plug


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("turned", [False, True])
def test_the_data_channel_of_a_board_is_told_from_its_console_in_any_order(system, turned):
    console, data = SYSTEMS[system]
    ports = [*STRANGERS, *([data, console] if turned else [console, data])]
    assert channels(PICO, ports) == Channels(console.device, data.device)


@pytest.mark.parametrize("system", SYSTEMS)
def test_a_board_with_one_channel_has_only_a_console(system):
    console = SYSTEMS[system][0]
    if system != "macOS":  # there the one port would not have the other's name
        assert channels(PICO, [console, *STRANGERS]) == Channels(console.device, None)


def test_ports_of_another_board_are_never_taken():
    assert channels(PICO, STRANGERS) == Channels()
    nameless = Drive(PICO.path, "9.2.1", "a board without a UID")
    assert channels(nameless, [*STRANGERS, SYSTEMS["Linux"][0]]) == Channels()


def test_boot_out_txt_tells_version_board_and_uid(tmp_path):
    found = drive_at(make_drive(tmp_path / "d"))
    assert (found.version, found.name) == ("9.2.1", "Raspberry Pi Pico with rp2040")
    assert (found.board_id, found.uid) == ("raspberry_pi_pico", UID)


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ({"INFO_UF2.TXT": "Board-ID: RPI-RP2\n"}, "bootloader, without CircuitPython: install that first"),
        ({"notes.txt": ""}, "no boot_out.txt"),
        ({"boot_out.txt": "something else\n"}, "not CircuitPython's"),
        (None, "there is no such drive"),
    ],
)
def test_a_wrong_drive_is_refused_with_what_it_is(tmp_path, files, says):
    place = tmp_path / "drive"
    if files is not None:
        place.mkdir()
        for name, text in files.items():
            (place / name).write_text(text)
    with pytest.raises(errors.WrongDrive, match=says):
        micropython.deploy(Options(drive=place))
    assert not place.exists() or {path.name for path in place.iterdir()} == set(files or {})


@pytest.mark.parametrize("version", ["8.0.0", "7.3.3", "6.2.0-beta.4-93-g0105b30a0"])
def test_a_circuitpython_that_cannot_switch_its_watchdog_off_is_refused_by_its_version(tmp_path, version):
    with pytest.raises(errors.WrongDrive, match=r"9\.1 or later is needed"):
        check_version(drive_at(make_drive(tmp_path / "d", version)))


@pytest.mark.parametrize("version", ["9.1.0", "10.0.0-beta.2", "somebody's-own-build"])
def test_later_ones_and_ones_own_builds_are_taken(tmp_path, version):
    check_version(drive_at(make_drive(tmp_path / "d", version)))


def test_on_linux_fat_volumes_are_looked_at_and_nothing_else(tmp_path):
    table = tmp_path / "mounts"
    table.write_text(
        "/dev/sda1 /media/me/MY\\040PY vfat rw 0 0\n/dev/sdb1 / ext4 rw 0 0\nserver:/x /mnt/x nfs rw 0 0\nodd\n"
    )
    assert discovery.fat_mounts(table) == [Path("/media/me/MY PY")]
    assert discovery.fat_mounts(tmp_path / "none") == []


def test_on_macos_every_volume_is_looked_at(tmp_path, monkeypatch):
    root = make_drive(tmp_path / "Volumes" / "CIRCUITPY")
    monkeypatch.setattr(discovery.sys, "platform", "darwin")
    monkeypatch.setattr(discovery, "Path", lambda _name: tmp_path / "Volumes")
    assert discovery.mounted() == [root]


class Kernel:
    """What Windows says: C: is a disk, E: and G: are removable, G: is read-only."""

    def GetLogicalDrives(self) -> int:
        return 1 << 2 | 1 << 4 | 1 << 6

    def GetDriveTypeW(self, root: str) -> int:
        return 3 if root.startswith("C") else 2

    def GetDiskFreeSpaceW(self, root: str, *numbers) -> int:
        for number, value in zip(numbers, (2, 512, 77, 1000), strict=True):
            number._obj.value = value
        return 1

    def GetVolumeInformationW(self, root, _name, _size, _serial, _longest, flags, _system, _length) -> int:
        flags._obj.value = 0x80000 if root.startswith("G") else 0
        return 1


@pytest.fixture
def windows(monkeypatch):
    monkeypatch.setattr(discovery.sys, "platform", "win32")
    monkeypatch.setattr(ctypes, "windll", SimpleNamespace(kernel32=Kernel()), raising=False)


def test_on_windows_removable_drive_letters_are_looked_at(windows):
    assert discovery.mounted() == [Path("E:\\"), Path("G:\\")]


@pytest.mark.parametrize(("letter", "read_only"), [("E:", False), ("G:", True)])
def test_on_windows_room_is_counted_in_its_clusters_and_a_read_only_volume_is_known(windows, letter, read_only):
    place = SimpleNamespace(resolve=lambda: SimpleNamespace(drive=letter))
    assert discovery.room(place) == discovery.Room(77, 1024, read_only)


def test_the_one_drive_that_is_there_is_meant(plugged):
    (root,) = plugged(["CIRCUITPY"], [])
    assert choose(Options()) == drive_at(root)


def test_without_a_drive_a_micropython_board_is_meant(plugged):
    plugged([], [MICROPYTHON])
    assert choose(Options()) is None


@pytest.mark.parametrize(("names", "ports"), [(["A", "B"], []), (["A"], [MICROPYTHON])])
def test_several_boards_are_listed_and_none_is_touched(plugged, names, ports):
    roots = plugged(names, ports)
    with pytest.raises(errors.SeveralBoardsFound) as e:
        choose(Options())
    assert all(f"--drive {root}" in str(e.value) for root in roots)
    assert all(port.device in str(e.value) for port in ports)


def test_a_named_port_decides_between_the_drive_of_its_board_and_micropython(plugged):
    (root,) = plugged(["CIRCUITPY"], [MICROPYTHON, *SYSTEMS["Linux"]])
    assert choose(Options(port="/dev/ttyACM0")) == choose(Options(port="/dev/ttyACM1")) == drive_at(root)
    assert choose(Options(port=MICROPYTHON.device)) is None


def test_a_drive_that_tells_no_uid_takes_its_ports_from_the_one_that_is_named(plugged):
    (root,) = plugged(["CIRCUITPY"], SYSTEMS["Linux"])
    (root / "boot_out.txt").write_text(BOOT_OUT.split("UID")[0].format(version="9.2.1"))
    assert choose(Options(drive=root)).uid == ""
    assert choose(Options(drive=root, port="/dev/ttyACM0")).uid == UID


def test_a_named_port_and_a_named_drive_of_two_boards_are_refused(plugged):
    (root,) = plugged(["CIRCUITPY"], [MICROPYTHON])
    with pytest.raises(errors.WrongDrive, match="not of one board"):
        choose(Options(port=MICROPYTHON.device, drive=root))


def test_of_a_drive_and_its_copy_on_a_memory_stick_one_is_to_be_named(plugged):
    roots = plugged(["CIRCUITPY", "STICK"], SYSTEMS["Linux"])
    with pytest.raises(errors.SeveralBoardsFound, match="name one") as e:
        choose(Options(port="/dev/ttyACM0"))
    assert all(f"--drive {root}" in str(e.value) for root in roots)


def test_a_bootloader_drive_is_named_when_there_is_no_board(plugged, monkeypatch, tmp_path):
    plugged([], [])
    (tmp_path / "INFO_UF2.TXT").write_text("")
    monkeypatch.setattr(discovery, "mounted", lambda: [tmp_path])
    with pytest.raises(errors.NoBoardFound, match=rf"{tmp_path} is a bootloader.*circuitpython\.org"):
        micropython.deploy(Options())


def test_a_mount_is_found_by_its_drive_and_opened_at_its_data_channel(plugged, capsys):
    (root,) = plugged(["CIRCUITPY"], [*STRANGERS, *SYSTEMS["Linux"]])
    assert mirrormount.transport.discovery.find() == []  # some CircuitPython board, not a mount
    (root / "mountfw").mkdir()
    assert mirrormount.transport.discovery.find_one() == "/dev/ttyACM0"
    assert main.main(["ports"]) == 0
    assert f"/dev/ttyACM0  CircuitPython on Raspberry Pi Pico with rp2040, drive {root}" in capsys.readouterr().out


def test_a_data_channel_whose_drive_is_not_seen_is_named_but_not_opened(plugged):
    plugged([], SYSTEMS["Linux"])
    with pytest.raises(errors.NoBoardFound, match="listens at /dev/ttyACM0, but its drive is not mounted"):
        mirrormount.transport.discovery.find_one()


def test_this_computers_volumes_can_be_listed():
    assert all(isinstance(drive, Drive) for drive in discovery.find_drives())
    assert discovery.room(Path.cwd()).cluster_bytes > 0
