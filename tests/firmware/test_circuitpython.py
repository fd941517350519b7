"""The CircuitPython port on the fakes of its modules: virtual boards in lockstep, on CPython and a MicroPython VM."""

import re
import shutil
from pathlib import Path

import pytest
from circuitpy_board import PERIOD_US, STEP_US, Board

from mirrormount.errors import EmulatorMissing
from mirrormount_sim import machines
from mirrormount_sim.board import Options, make_simulation
from mirrormount_sim.machines import firmware_folder
from mirrormount_sim.simulation import Simulation
from mountfw.ports.shared import FOLDERS

ESP32_S3 = "adafruit_feather_esp32s3_4mbflash_2mbpsram"


@pytest.fixture
def board(new) -> Board:
    return new()


TRANSCRIPT = (
    (b"*IDN?\n", b"mirrormount,Raspberry Pi Pico,e6616408432f5a21,0.3.0\r\n"),
    (b"VE?\n", b"MM2 Version 0.3.0 mirrormount\r\n"),
    (b"0255-100", b"#\r\n0255-100\r\n255\r\n-100\r\n255\r\n100\r\n"),
    (b"!\n1XE?\n", b"3,"),
    (b"1XP20000;1VA20;1DH0;1PR3;1PR1;TB?\n", b"114, AXIS 1 MOTION IN PROGRESS\r\n"),
    (None, 400_000),
    (b"1MD?;1TP?;TE?\n", b"1; 3; 0\r\n"),
    (b"255-\nTE?\n", b"60\r\n"),
    (b"1SL-5;1SR5;1ZH8;1PR9;TE?\n", b"106\r\n"),
    (b"2MV+\n", b""),
    (b"00000000", b"#\r\n00000000\r\n0\r\n0\r\n0\r\n0\r\n"),
    (b"2XE?\n", b"2,"),
)


@pytest.mark.parametrize("machine", ["cpython", "circuitpython"])
def test_one_transcript_of_the_wire_holds_on_both_ports(machine, boards):
    board = boards(make_simulation(Options(machine=machine)))
    for sent, expected in TRANSCRIPT:
        if sent is None:
            board.run(expected)
            continue
        board.received.clear()
        board.send(sent)
        board.run(60_000)
        said = bytes(board.received)
        assert said.startswith(expected) and (said == expected or expected.endswith(b",")), sent
    assert board.off()


@pytest.mark.parametrize("machine", ["cpython", "circuitpython", "micropython"])
def test_the_analog_input_is_told_on_every_port(machine, boards, tmp_path):
    if machine == "micropython":
        root = tmp_path / "root"
        shutil.copytree(firmware_folder() / "mountfw", root / "mountfw", ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(root / "mountfw" / "entry" / "main.py", root / "main.py")
        try:
            board = boards(Simulation(machines.micropython(root)))
        except EmulatorMissing as e:
            pytest.skip(str(e))
    else:
        board = boards(make_simulation(Options(machine=machine)))
    value = [0]
    board.simulation.analog[28] = lambda: value[0]
    for value[0] in (0, 12_345, 65_535):
        assert board.ask(b"XW?\n") == b"%d\r\n" % value[0]


@pytest.mark.parametrize("machine", ["cpython", "circuitpython"])
def test_pins_change_in_the_same_order_on_both_ports(machine, boards):
    board = boards(make_simulation(Options(machine=machine)))
    board.send(b"1PR1\n")
    board.run(300_000)
    changes = {(pin, duty): us for us, pin, duty in board.simulation.edges}
    assert list(changes)[:2] == [("m1_pos", 65535), ("m1_en", 65535)]
    # the duty of the enable waits for its period, the leg does not
    assert changes["m1_pos", 0] >= changes["m1_en", 0] - PERIOD_US
    assert board.off()


def test_a_pulse_is_good_to_a_step_of_the_clock_and_none_differs_from_another(board):
    board.send(b"1VA2.4;1PR10\n")
    board.run(6_000_000)
    on_us = [off - on for on, off in zip(board.edges("m1_en", True), board.edges("m1_en", False), strict=True)]
    assert len(on_us) == 10
    assert all(200_000 - PERIOD_US <= us < 200_000 + 2 * STEP_US + 250 for us in on_us), on_us
    counted = int(board.ask(b"1XE?\n").split(b",")[2])
    assert abs(counted - sum(on_us)) < 10 * 250


def test_a_stop_is_obeyed_and_its_duty_is_off_with_the_pwms_period(board):
    for duty in (255, 100):
        board.send(b"%04d0000" % duty)
        board.run(30_000)
        sent_us = board.simulation.us
        board.send(b"!")
        assert board.run(5_000, board.off)
        legs_us, enable_us = board.edges("m1_pos", False)[-1], board.edges("m1_en", False)[-1]
        assert enable_us - sent_us < 1_000
        assert abs(enable_us - legs_us) <= PERIOD_US + 20


def test_0x03_on_the_data_channel_is_a_stop_and_the_firmware_goes_on(board):
    board.send(b"02550000")
    board.run(30_000)
    board.send(b"\x03\n")
    board.run(60_000)
    assert board.off()
    assert board.ask(b"1XE?\n").startswith(b"3,")


def test_a_host_that_goes_stops_what_moves_as_an_abort(board):
    board.send(b"1MV+\n")
    board.run(50_000)
    assert not board.off()
    board.simulation.opened(False)
    gone_us = board.simulation.us
    assert board.run(200_000, board.off)
    assert board.simulation.us - gone_us < 30_000
    board.simulation.opened(True)
    assert board.ask(b"1XE?;TE?\n").startswith(b"3,")


def test_a_host_that_was_never_there_stops_nothing(new):
    board = new()
    board.simulation.opened(False)
    board.run(100_000)
    board.simulation.opened(True)
    board.send(b"1MV+\n")
    board.run(100_000)
    assert not board.off()


def test_an_end_stop_is_polled_and_cuts_within_a_pass(new):
    board = new(switches=True)
    board.send(b"1XL3;1MV+\n")
    board.run(100_000)
    assert not board.off()
    opened_us = board.simulation.us
    board.simulation.bench.broken.add("m1_sw_pos")
    assert board.run(20_000, board.off)
    assert board.edges("m1_en", False)[-1] - opened_us < 2_000
    assert board.ask(b"TE?\n") == b"104\r\n"


def test_settings_and_a_rested_position_are_in_the_non_volatile_memory_after_a_restart(new, tmp_path):
    board = new()
    board.send(b"1XP20000;SM\n")
    board.run(500_000)
    board.send(b"1DH0;1PR3\n")
    board.run(12_500_000)
    board.simulation.close()
    assert not (tmp_path / "mountfw.settings").exists()
    assert b"1 pulse_us 20000\n" in (tmp_path / "nvm.bin").read_bytes()
    board = new()
    assert board.ask(b"1XP?;1TP?;TE?\n") == b"20000; 3; 0\r\n"
    assert board.ask(b"XS?\n").split(b"|")[1].endswith(b",1")  # certainty: counted


def test_settings_are_a_file_where_the_drive_is_the_boards_own(new, tmp_path):
    boot = (machines.firmware_folder() / "mountfw" / "entry" / "boot.py").read_text()
    (tmp_path / "boot.py").write_text(boot + "\nimport storage\nstorage.remount('/', False)\n")
    board = new()
    board.send(b"1XP30000;SM\n")
    board.run(500_000)
    board.simulation.close()
    assert b"30000" in (tmp_path / "mountfw.settings").read_bytes()
    assert not (tmp_path / "nvm.bin").exists()
    assert new().ask(b"1XP?\n") == b"30000\r\n"


def test_a_hung_loop_is_reset_by_the_watchdog_and_the_next_start_says_so(new, tmp_path):
    code = (machines.firmware_folder() / "mountfw" / "entry" / "code.py").read_text()
    hang = "import microcontroller\nfrom mountfw.app import App\nreal = App._show\ndef show(app, now_us):\n"
    hang += "    if app.controller.driving(): microcontroller.delay_us(5_000_000)\n    real(app, now_us)\n"
    (tmp_path / "code.py").write_text(hang + "App._show = show\n" + code)
    board = new()
    board.send(b"1MV+\n")
    board.run(6_000_000)
    assert board.off()
    board.simulation.lit = False
    board.boot()
    assert board.ask(b"TE?;XH?\n").startswith(b"66; ")


def test_a_board_with_too_few_endpoints_talks_on_its_console_where_ctrl_c_gives_the_prompt(new):
    board = new(ESP32_S3)
    board.run(300_000)
    assert board.ask(b"*IDN?\n").startswith(b"mirrormount,Adafruit Feather ESP32-S3,")
    board.send(b"02550000")
    board.run(30_000)
    board.received.clear()
    board.send(b"\x03")
    assert board.run(500_000, lambda: b">>> " in board.received)
    assert b"motors are off" in board.received
    board.received.clear()
    board.send(b"\x04")
    board.run(500_000, lambda: b"soft reboot" in board.received)
    board.run(300_000)
    assert board.ask(b"*IDN?\n").startswith(b"mirrormount,")


def test_a_bridge_with_two_pwms_is_driven_by_adafruits_dc_motor(new):
    board = new("pico_drv8833", two_pwm=True)
    board.send(b"0255-100")
    board.run(30_000)
    duties = board.simulation.bench.duties()
    assert (duties["m1_pos"], duties["m1_neg"], duties["m2_pos"]) == (1, 0, 0)
    assert duties["m2_neg"] == pytest.approx(100 / 255, abs=1e-3)
    board.send(b"!")
    assert board.run(1_000, board.off)
    board.ask(b"1XP50000\n")
    board.send(b"1PR2\n")
    board.run(1_500_000)
    assert board.off()
    position, ended, error = board.ask(b"1TP?;1XE?;TB?\n").split(b"; ")
    assert (position, ended[:4], error) == (b"2", b"1,2,", b"0, NO ERROR DETECTED\r\n")


def test_a_board_without_a_board_file_drives_nothing_and_says_what_to_write(tmp_path, boards, capfd):
    board = boards(Simulation(machines.circuitpython(tmp_path, "no_such_board")))
    board.send(b"02550255")
    board.run(100_000)
    assert board.off() and not board.simulation.edges


def test_the_hash_is_over_the_files_on_the_drive(tmp_path, boards):
    import hashlib

    root = tmp_path / "root"
    source = machines.firmware_folder() / "mountfw"
    shutil.copytree(source, root / "mountfw", ignore=shutil.ignore_patterns("__pycache__", "micropython*.py"))
    for name in ("boot.py", "code.py"):
        shutil.copy(source / "entry" / name, root / name)
    total = hashlib.sha256()
    for folder in ("", "mountfw", *(f"mountfw/{name}" for name in FOLDERS)):
        for file in sorted((root / folder).iterdir()):
            if file.suffix == ".py":
                total.update(file.relative_to(root).as_posix().encode() + hashlib.sha256(file.read_bytes()).digest())
    board = boards(make_simulation(Options(machine="circuitpython", firmware=root, files=tmp_path / "drive")))
    assert board.ask(b"XF?\n").decode().strip() == f"sha256-{total.hexdigest()}"


def test_without_sha_256_in_the_build_the_firmware_runs_and_tells_a_checksum(tmp_path, boards):
    entry = machines.firmware_folder() / "mountfw" / "entry" / "code.py"
    (tmp_path / "code.py").write_text(
        "import hashlib\n\n\ndef new(_name):\n    raise ValueError('Unsupported hash algorithm')\n\n\n"
        f"hashlib.new = new\nexec(open({str(entry)!r}).read())\n"
    )
    board = boards(make_simulation(Options(machine="circuitpython", files=tmp_path)))
    assert re.fullmatch(rb"crc32-[0-9a-f]{8}\r\n", board.ask(b"XF?\n"))
    assert board.ask(b"*IDN?\n").startswith(b"mirrormount,")


def test_time_that_the_port_tells_is_the_clocks_step_and_never_wrong_by_more(tmp_path: Path, boards):
    check = (
        "import supervisor, time, usb_cdc\n"
        "import _seam\n"
        "from mountfw.ports import circuitpython as port\n"
        "begin = None\n"
        "bad = []\n"
        "for i in range(3000):\n"
        "    _seam.seam.tick(317)\n"
        "    us, true = port.ticks_us(), _seam.seam.t\n"
        "    if begin is None:\n"
        "        begin = (true - us) & 0x3FFFFFFF\n"
        "    late = ((true - us - begin + 0x1FFFFFFF) & 0x3FFFFFFF) - 0x1FFFFFFF\n"
        "    bad.append(late)\n"
        "usb_cdc.data.write_timeout = 0\n"
        "usb_cdc.data.write(b'%d\\n' % (max(bad) - min(bad)))\n"
    )
    (tmp_path / "code.py").write_text(check)
    board = boards(Simulation(machines.circuitpython(tmp_path)))
    board.run(2_000_000, lambda: b"\n" in board.received)
    assert int(board.received) <= 2 * STEP_US + 10


def test_the_mount_is_there_at_the_boards_own_prompt(new, tmp_path):
    session = "from mountfw.repl import m\nm.y.step(2)\nm.x.jog(-0.5, ms=300)\nimport usb_cdc\n"
    session += "usb_cdc.data.write(b'%d\\n' % (m.y.position * 1000))\n"
    (tmp_path / "code.py").write_text(session)
    board = new()
    board.run(3_000_000, lambda: b"\n" in board.received)
    assert bytes(board.received) == b"2000\n"
    assert board.off()
    (on, off) = (board.edges("m2_en", up)[0] for up in (True, False))
    assert 300_000 - PERIOD_US <= off - on <= 300_000 + 2 * STEP_US + 500
