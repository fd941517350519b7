"""flash: a folder stands for the drive of a boot loader, a MicroPython VM for the board that comes from it."""

import errno
import hashlib
import http.server
import re
import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from served import run_cli, wait_for
from uf2_images import RP2350, Rom, image, make_drive, program, put

from mirrormount import errors
from mirrormount.deploy import esp, flash
from mirrormount.deploy.micropython import Mpremote
from mirrormount.deploy.prompt import Options
from mirrormount.device.mount import Mount
from mirrormount.supported import DOWNLOADS, MICROPYTHON, Download
from mirrormount.terminal import Progress
from mirrormount.transport import discovery
from mirrormount.transport.discovery import Bootloader, Room


@pytest.fixture
def plugged(tmp_path, monkeypatch) -> SimpleNamespace:
    """What is plugged in: the folders of drives that are mounted, and the links to boards with a port."""
    there = SimpleNamespace(drives=[tmp_path / "RPI-RP2"], ports=[])

    def ports() -> list[SimpleNamespace]:
        found = [str(port) for port in there.ports if port.exists()]
        return [SimpleNamespace(device=port, vid=0x2E8A, pid=5, serial_number="") for port in found]

    monkeypatch.setattr(discovery, "mounted", lambda: [path for path in there.drives if path.exists()])
    monkeypatch.setattr("serial.tools.list_ports.comports", ports)
    monkeypatch.setattr(discovery, "unmounted_bootloaders", list)
    for name in ("_DRIVE_S", "_PORT_S"):
        monkeypatch.setattr(flash, name, 20.0)
    return there


@pytest.fixture
def picture(tmp_path) -> str:
    return str(put(tmp_path, image()))


@pytest.fixture
def port(tmp_path, monkeypatch, plugged) -> Path:
    """Where a board will be, once it is touched; for tests that end before the deploy."""
    there = tmp_path / "ttyACM5"
    plugged.ports = [there]
    real = flash.open_port
    closed = SimpleNamespace(close=lambda: None)
    monkeypatch.setattr(flash, "open_port", lambda named: closed if named == str(there) else real(named))
    monkeypatch.setattr(flash, "deploy", lambda options, _progress: f"OK: {options.port}")
    return there


def loader(path: Path) -> Bootloader:
    found = discovery.read_bootloader(path)
    assert found
    return found


def refused(expected: str, *words: str) -> str:
    """What `mirrormount flash` refuses, in the last line of stderr."""
    run = run_cli("flash", *words)
    *_, last = run.stderr.splitlines()
    assert (run.returncode, run.stdout) == (1, "")
    assert re.search(expected, last), run.stderr
    assert last.startswith("mirrormount: ")
    return last


# ---- from a drive, or a board that runs something, to a mount


def test_an_empty_board_in_its_boot_loader_becomes_a_mount_in_one_command(boot, plugged, picture, tmp_path):
    drive = make_drive(tmp_path / "RPI-RP2")
    plugged.ports = [tmp_path / "0" / "mount"]
    rom = Rom(drive, boot)
    settings = put(tmp_path, b"[x]\npulse_us = 123000\n", "settings.toml")
    run = run_cli("flash", "--image", picture, "--settings", str(settings))
    assert run.returncode == 0, run.stderr
    assert rom.taken == image()
    lines = run.stdout.splitlines()
    assert lines[0].startswith("OK: Raspberry Pi Pico, mountfw ") and "(0 unchanged)" in lines[0]
    assert lines[1] == "1 settings taken (saved on the board)"
    assert "ok         firmware" in run.stdout and "FAILED" not in run.stdout
    with Mount.open(str(plugged.ports[0])) as mount:
        assert mount.x.pulse_us == 123_000


def test_a_board_at_a_port_is_sent_to_its_boot_loader_if_somebody_says_yes(boot, plugged, picture, tmp_path, port):
    root = tmp_path / "theirs"
    root.mkdir()
    (root / "boot.py").write_text("import machine\nmachine.bootloader = lambda: open('sent', 'w').close()\n")
    (root / "main.py").write_text("print('a program of somebody else')\n")
    first = boot(root)
    refused("nobody said yes", first.port, "--image", picture)
    assert not (root / "sent").exists()

    def bootsel() -> None:
        wait_for((root / "sent").exists, "machine.bootloader()")
        first.board.kill()
        Rom(make_drive(tmp_path / "RPI-RP2"), port.touch)

    threading.Thread(target=bootsel, daemon=True).start()
    found, _ = flash.flash(Options(port=first.port), Path(picture), False, lambda _question: True)
    assert found == str(port)


def test_a_board_whose_motor_runs_is_not_sent_to_its_boot_loader(deployed, plugged, picture, monkeypatch):
    monkeypatch.setattr(Mpremote, "start_bootloader", None)  # would fail loudly
    plugged.ports = [Path(deployed.port)]
    deployed.run()
    refused("a motor moves", "--yes", "--image", picture)
    assert deployed.board.driving()


def test_a_board_that_shows_no_drive_is_told_and_its_firmware_goes_on(deployed, plugged, picture, monkeypatch):
    monkeypatch.setattr(Mpremote, "start_bootloader", lambda _self: None)
    monkeypatch.setattr(flash, "_DRIVE_S", 0.3)
    refused("shows no drive: hold BOOTSEL", deployed.port, "--yes", "--image", picture)
    assert deployed.ask("VE?").startswith("MM2")


class Silent:
    """A port at which nobody answers."""

    lockstep = False

    def read(self, timeout_s: float) -> bytes:
        return b""

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass


def test_a_board_without_python_is_sent_there_by_a_port_that_opens_and_closes_at_1200_baud(picture, monkeypatch, port):
    opened = []

    class Serial:
        dtr = True

        def __init__(self, name: str, baud: int) -> None:
            opened.append((name, baud))

        def __enter__(self) -> "Serial":
            return self

        def __exit__(self, *_: object) -> None:
            opened.append(self.dtr)

    monkeypatch.setattr("serial.Serial", Serial)
    monkeypatch.setattr(flash, "open_port", lambda _port: Silent())
    monkeypatch.setattr(flash, "_DRIVE_S", 0.1)
    for name in ("_ANSWER_S", "_PROMPT_S", "_QUIET_S"):
        monkeypatch.setattr(f"mirrormount.deploy.prompt.{name}", 0.05)
    port.touch()
    with pytest.raises(errors.NoBootloader):
        flash.flash(Options(port=str(port)), Path(picture), False, lambda _question: True)
    assert opened == [(str(port), 1200), False]


# ---- which board


def test_without_a_board_it_says_to_hold_bootsel_and_which_drive_is_not_mounted(plugged, picture, monkeypatch):
    monkeypatch.setattr(flash, "unmounted_bootloaders", lambda: [Path("/dev/disk/by-label/RPI-RP2")])
    refused("no board found: hold BOOTSEL.*by-label/RPI-RP2 is one, and has to be mounted", "--image", picture)


def test_of_two_boards_one_is_to_be_named(plugged, picture, tmp_path):
    plugged.drives = [make_drive(tmp_path / name) for name in ("RPI-RP2", "RPI-RP21")]
    last = refused("several boards are in their boot loader", "--image", picture)
    assert all(f"--drive {drive}" in last for drive in plugged.drives)
    plugged.drives = []
    plugged.ports = [put(tmp_path, b"", name) for name in ("ttyACM0", "ttyACM1")]
    refused("several boards found, name one: .*ttyACM0, .*ttyACM1", "--image", picture)


def test_a_port_that_is_not_there_and_an_address_are_told(plugged, picture):
    refused("there is no port COM9, and no drive", "COM9", "--image", picture)
    refused("flash needs a serial port, not virtual://", "virtual://", "--image", picture)


@pytest.mark.parametrize(
    ("board_id", "data", "why"),
    [
        ("RP2350", image(), r"is for an RP2040 \(0xe48bff56\), and .* is an RP2350"),
        ("RPI-RP2", image(family=RP2350), r"is for an RP2350 \(0xe48bff59\), and .* is an RP2040"),
        ("SAMD21G18A-Metro-v0", image(), r"boot loader of another chip \(SAMD21G18A-Metro-v0\)"),
        ("RPI-RP2", image()[:-512], "cut or damaged"),
        ("RPI-RP2", image(program(version="1.20.0")), "1.22 or later is needed"),
    ],
    ids=["an RP2350", "an RP2350's image", "another chip", "cut", "old"],
)
def test_an_image_that_is_not_for_the_board_is_refused_and_nothing_is_written(plugged, tmp_path, board_id, data, why):
    drive = make_drive(tmp_path / "RPI-RP2", board_id)
    before = sorted(drive.iterdir())
    refused(why, "--image", str(put(tmp_path, data)))
    assert sorted(drive.iterdir()) == before


def test_an_image_of_an_rp2350_goes_to_an_rp2350_whole_and_it_is_said_that_nobody_tried(
    plugged, tmp_path, port, capsys
):
    data = image(family=RP2350)
    rom = Rom(make_drive(tmp_path / "RPI-RP2", "RP2350"), port.touch)
    assert flash.flash(Options(), put(tmp_path, data), False, bool)[0] == str(port)
    assert "MicroPython 1.25.0 for a Raspberry Pi Pico 2 with RP2350, not tried on hardware" in capsys.readouterr().err
    assert rom.taken == data  # with its first block


def test_a_drive_that_is_named_must_be_a_boot_loaders(plugged, picture, tmp_path):
    refused("is no boot loader's drive", "--drive", str(tmp_path), "--image", picture)


def test_a_board_file_with_a_slip_is_told_before_anything_is_written(plugged, picture, tmp_path):
    drive = make_drive(tmp_path / "RPI-RP2")
    slip = put(tmp_path, b"NAME = 7\n", "mine.py")
    refused("mine.py: ", "--image", picture, "--pins", str(slip))
    assert not list(drive.glob("*.uf2"))


# ---- the copy


@pytest.mark.parametrize(
    ("there", "error", "why"),
    [
        (Room(10, 512, False), errors.DriveFull, "5 KB are free; nothing was written"),
        (Room(10_000, 512, True), errors.DriveReadOnly, "cannot be written to; nothing was written"),
    ],
    ids=["full", "read-only"],
)
def test_a_drive_without_room_or_that_is_read_only_is_told(tmp_path, monkeypatch, there, error, why):
    monkeypatch.setattr(flash, "room", lambda _path: there)
    drive = make_drive(tmp_path / "RPI-RP2")
    with pytest.raises(error, match=why):
        flash.copy(image(), loader(drive), Progress())
    assert not list(drive.glob("*.uf2"))


@pytest.mark.parametrize(("number", "error"), [(errno.ENOSPC, errors.DriveFull), (errno.EROFS, errors.DriveReadOnly)])
def test_a_drive_that_turns_out_to_be_full_or_read_only_is_told(tmp_path, monkeypatch, number, error):
    def fail(_descriptor):
        raise OSError(number, "injected")

    monkeypatch.setattr("mirrormount.deploy.flash.os.fsync", fail)
    with pytest.raises(error, match="RPI-RP2"):
        flash.copy(image(), loader(make_drive(tmp_path / "RPI-RP2")), Progress())


@pytest.mark.parametrize(
    ("broken", "why"),
    [(False, "has all of the image, and the board does not take it"), (True, r"gives an error \(injected\)")],
)
def test_a_drive_that_stays_is_told(plugged, picture, tmp_path, monkeypatch, broken, why):
    def fail(_descriptor):
        raise OSError(errno.EIO, "injected")

    make_drive(tmp_path / "RPI-RP2")
    monkeypatch.setattr(flash, "_PORT_S", 0.2)
    if broken:
        monkeypatch.setattr("mirrormount.deploy.flash.os.fsync", fail)
    refused(f"RPI-RP2 {why}; the board is still in its boot loader", "--image", picture)


def _goes_with_an_error(drive: Path, monkeypatch, restart: Callable[[], object] = str) -> None:
    """The drive goes while the system writes: the copy ends with an error. Then the board does something."""

    def fail(_descriptor):
        shutil.rmtree(drive)
        restart()
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("mirrormount.deploy.flash.os.fsync", fail)


def test_a_cable_that_is_pulled_in_the_middle_is_told_with_the_way_back(plugged, picture, tmp_path, monkeypatch):
    _goes_with_an_error(make_drive(tmp_path / "RPI-RP2"), monkeypatch)
    monkeypatch.setattr(flash, "_PORT_S", 0.3)
    refused(r"went while the image was copied \(Input/output error\).*Hold BOOTSEL.*in ROM", "--image", picture)


def test_a_drive_that_goes_with_an_error_when_all_is_there_has_done_its_work(picture, tmp_path, monkeypatch, port):
    _goes_with_an_error(make_drive(tmp_path / "RPI-RP2"), monkeypatch, port.touch)
    assert flash.flash(Options(), Path(picture), False, bool)[0] == str(port)


def test_a_board_that_does_not_come_back_is_told(plugged, picture, tmp_path, monkeypatch):
    monkeypatch.setattr(flash, "_PORT_S", 0.3)
    Rom(make_drive(tmp_path / "RPI-RP2"), lambda: None)
    refused("no port of MicroPython came: plug the board in again", "--image", picture)


def test_two_ports_that_come_at_once_are_told_and_neither_is_written_to(plugged, picture, tmp_path):
    plugged.ports = [tmp_path / "ttyACM0", tmp_path / "ttyACM1"]
    Rom(make_drive(tmp_path / "RPI-RP2"), lambda: [port.touch() for port in plugged.ports])
    refused("several new ports: .*ttyACM0, .*ttyACM1", "--image", picture)
    assert [port.read_bytes() for port in plugged.ports] == [b"", b""]


# ---- the image


@pytest.fixture
def server(tmp_path, monkeypatch):
    """A server on this computer in the place of micropython.org, and the cache."""
    (tmp_path / "web").mkdir()
    asked = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *arguments):
            super().__init__(*arguments, directory=str(tmp_path / "web"))

        def log_message(self, *_arguments):
            asked.append(self.path)

    monkeypatch.setenv("MIRRORMOUNT_CACHE", str(tmp_path / "cache"))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as found:
        threading.Thread(target=found.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{found.server_address[1]}/image.uf2"
        monkeypatch.setattr(Download, "url", property(lambda _self: url))
        yield SimpleNamespace(folder=tmp_path / "web", cache=tmp_path / "cache" / "uf2", asked=asked)
        found.shutdown()


@pytest.fixture
def pinned(monkeypatch) -> Download:
    """The pinned image is ours."""
    mine = replace(DOWNLOADS["RP2040"], sha256=hashlib.sha256(image()).hexdigest())
    monkeypatch.setitem(DOWNLOADS, "RP2040", mine)
    return mine


def test_an_image_is_fetched_once_checked_and_kept(server, pinned):
    put(server.folder, image())
    path = flash.fetch("RP2040", False, Progress())
    assert path == server.cache / pinned.name and path.read_bytes() == image()
    assert flash.fetch("RP2040", True, Progress()) == path  # offline, too
    assert len(server.asked) == 1


def test_what_has_another_hash_is_not_used(server, pinned):
    put(server.folder, b"<html>please log in</html>")
    with pytest.raises(errors.ImageMissing, match=r"is not that image, and was not used: put it there as .*SHA-256"):
        flash.fetch("RP2040", False, Progress())
    assert not list(server.cache.glob("RPI*"))


def test_what_cannot_be_fetched_and_offline_say_what_to_put_where(server, pinned):
    for offline, why in ((False, "cannot be fetched here"), (True, "--offline, and there is no")):
        with pytest.raises(errors.ImageMissing, match=why) as e:
            flash.fetch("RP2040", offline, Progress())
        for part in (str(server.cache / pinned.name), pinned.url, pinned.sha256, "--image"):
            assert part in str(e.value)


def test_for_a_chip_without_a_known_image_one_is_to_be_named(plugged, tmp_path):
    make_drive(tmp_path / "RPI-RP2", "RP2350")
    refused("for an RP2350 no image is known here: name one", "--offline")


def test_the_images_that_are_fetched_are_official_ones_that_were_tried():
    tried = {name for release in MICROPYTHON.releases for name in release.images}
    assert {download.name.removesuffix(".uf2") for download in DOWNLOADS.values()} <= tried
    assert all(len(bytes.fromhex(download.sha256)) == 32 for download in DOWNLOADS.values())


# ---- an ESP32


def esp_image(folder: Path, chip: int) -> Path:
    return put(folder, b"\xe9" + bytes(11) + chip.to_bytes(2, "little") + bytes(100), "esp.bin")


@pytest.mark.parametrize(("chip", "address"), [(0, "0x1000"), (2, "0x1000"), (5, "0x0"), (9, "0x0")])
def test_without_esptool_the_line_to_type_is_told(tmp_path, monkeypatch, chip, address):
    monkeypatch.setattr(esp.importlib.util, "find_spec", lambda _name: None)
    path = esp_image(tmp_path, chip)
    line = f"pip install esptool, then esptool --port COM3 write_flash {address} {path}"
    refused(re.escape(line), "COM3", "--image", str(path))


def test_esptool_is_called_if_it_is_there_and_the_deploy_is_left_to_the_user(tmp_path, monkeypatch):
    called = []
    monkeypatch.setattr(esp.importlib.util, "find_spec", lambda _name: True)
    monkeypatch.setattr(esp.subprocess, "call", lambda words: called.append(words) or 0)
    path = esp_image(tmp_path, 0)
    run = run_cli("flash", "COM3", "--image", str(path))
    assert run.returncode == 0
    assert "mirrormount deploy" in run.stdout and "not tried on hardware" in run.stdout
    assert called[0][-6:] == ["esptool", "--port", "COM3", "write_flash", "0x1000", str(path)]
    monkeypatch.setattr(esp.subprocess, "call", lambda _words: 2)
    refused("esptool has failed .exit status 2.", "COM3", "--image", str(path))


def test_an_esp_without_a_port_is_told(tmp_path):
    refused("mirrormount flash PORT --image", "--image", str(esp_image(tmp_path, 9)))
