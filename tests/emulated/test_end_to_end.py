"""From a board with nothing but MicroPython to a moving mirror and back, with the real image and the real mpremote."""

import shutil
import subprocess
import sys

import pytest
from served import HANG_S, ServedBoard, run_cli, wait_for

from mirrormount.deploy.firmware import firmware
from mirrormount.device.mount import Mount
from mirrormount.errors import EmulatorMissing, MountError
from mirrormount_sim import emulator

pytestmark = pytest.mark.wall_clock  # on a busy computer a board in real time answers later than its client waits


@pytest.fixture(scope="module")
def blank(tmp_path_factory):
    """A served board whose flash holds MicroPython alone. The tests at the end of this file go through it in order.

    It runs until the last of them, so nothing else comes after them: a board that waits takes a share of a processor.
    """
    try:
        emulator.find_image(None)
    except EmulatorMissing as e:
        pytest.skip(str(e))
    folder = tmp_path_factory.mktemp("rp2040")
    board = ServedBoard(folder, "--machine", "rp2040", "--flash", str(folder / "flash.bin"))
    yield board
    board.kill()
    board.process.stdout.close()


def mpremote(board: ServedBoard, *words: str) -> str:
    command = [sys.executable, "-m", "mpremote", "connect", str(board.link), *words]
    run = subprocess.run(command, capture_output=True, text=True, timeout=HANG_S, stdin=subprocess.DEVNULL)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


def mpremote_or_none(board: ServedBoard, *words: str) -> str | None:
    """For a board that is just restarting: None while its port is away."""
    try:
        return mpremote(board, *words)
    except (AssertionError, subprocess.TimeoutExpired):
        return None


def open_again(board: ServedBoard) -> Mount:
    """Open a board that is restarting: its port goes and comes back, then the firmware starts."""

    def attempt() -> Mount | None:
        try:
            return Mount.open(str(board.link))
        except MountError:
            return None

    return wait_for(attempt, "the firmware to answer after a restart")


def old_flash(folder):
    """A flash that holds the firmware as plain files, copied by hand: what a first user has."""
    flash = folder / "flash.bin"
    shutil.copyfile(emulator.flash_with_firmware(None, firmware(None)), flash)
    return flash


@pytest.fixture
def old(tmp_path):
    try:
        old_flash(tmp_path)
    except EmulatorMissing as e:
        pytest.skip(str(e))
    boards = []

    def switch_on() -> ServedBoard:
        folder = tmp_path / str(len(boards))
        folder.mkdir()
        boards.append(ServedBoard(folder, "--machine", "rp2040", "--flash", str(tmp_path / "flash.bin")))
        return boards[-1]

    yield switch_on
    for board in boards:
        board.kill()
        board.process.stdout.close()


@pytest.mark.full
def test_a_power_cut_in_mid_deploy_leaves_a_board_that_works_and_the_next_deploy_repairs_it(old, tmp_path):
    flash = tmp_path / "flash.bin"
    for writes in (7, 80):  # early and late; test_power_cuts.py cuts in each file, and in the commit
        board = old()
        deploy = subprocess.Popen(
            [sys.executable, "-m", "mirrormount", "deploy", "--port", str(board.link), "--replace-main"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        seen = {flash.stat().st_mtime_ns}

        def cut(writes=writes, deploy=deploy, seen=seen) -> bool:
            seen.add(flash.stat().st_mtime_ns)
            return len(seen) > writes or deploy.poll() is not None

        wait_for(cut, "the flash to be written")
        board.kill()
        deploy.kill()
        deploy.wait()
        again = old()
        with open_again(again) as mount:
            mount.x.step(1)
            assert mount.x.position == 1
        again.kill()  # at rest for long enough, it would record its position in the flash of the next one
    board = old()
    run = run_cli("deploy", "--port", str(board.link), "--replace-main")
    assert run.returncode == 0, run.stderr
    with open_again(board) as mount:
        mount.x.step(1)
    names = mpremote(board, "exec", "import os; print(*os.listdir('mountfw'))").split()
    assert "app.mpy" in names and "app.py" not in names  # the source would be imported first


def test_a_blank_board_says_that_the_firmware_is_missing(blank):
    run = run_cli("status", "--port", str(blank.link))
    assert run.returncode == 1
    assert "mountfw is not on this board" in run.stderr


def test_deploy_puts_the_firmware_on_it_and_it_answers(blank):
    run = run_cli("deploy", "--port", str(blank.link))
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith("OK: Raspberry Pi Pico, mountfw 0.3.0, 2 axes,")
    assert "(0 unchanged)" in run.stdout


def test_a_step_is_seen_on_the_pins(blank):
    with open_again(blank) as mount:
        mount.x.step(1)
        mount.y.step(-1)
    pins = [(e["pin"], e.get("duty", e.get("level"))) for e in blank.edges()]
    for motor, leg in (("m2", "pos"), ("m1", "neg")):
        mine = [(pin, value) for pin, value in pins if pin.startswith(motor)]
        assert mine == [(f"{motor}_{leg}", 1), (f"{motor}_en", 65535), (f"{motor}_en", 0), (f"{motor}_{leg}", 0)]


@pytest.mark.full
def test_a_second_deploy_changes_nothing(blank):
    run_cli("deploy", "--port", str(blank.link))
    run = run_cli("deploy", "--port", str(blank.link))
    assert run.returncode == 0, run.stderr
    files = int(run.stdout.split(" files (")[0].split()[-1])
    assert files > 10 and f"({files} unchanged)" in run.stdout


def test_it_starts_by_itself_after_a_hard_reset(blank):
    mpremote(blank, "reset")
    with open_again(blank) as mount:
        assert mount.identity.startswith("mirrormount,Raspberry Pi Pico,")
        assert mount.status().uptime_s < 60


@pytest.mark.full
def test_a_deploy_while_a_motor_moves_is_refused_and_the_motor_is_left_alone(blank):
    with open(blank.link, "wb", buffering=0) as raw:
        raw.write(b"\n1XM60000;1MV+\n")
    wait_for(blank.driving, "the motor to run")
    run = run_cli("deploy", "--port", str(blank.link))
    assert run.returncode == 1
    assert blank.driving()
    run_cli("stop", "--port", str(blank.link))
    assert not blank.driving()


@pytest.mark.full
def test_undeploy_leaves_the_board_as_it_was(blank):
    run = run_cli("undeploy", "--port", str(blank.link))
    assert run.returncode == 0, run.stderr

    ask = "import os; print('files', os.listdir('/'))"
    assert "files []" in wait_for(lambda: mpremote_or_none(blank, "exec", ask), "the prompt after undeploy")


FILL = """
import os
piece = bytes(4096)
with open('measurements', 'wb') as f:
    for i in range(os.statvfs('/')[3] - 12):
        f.write(piece)
print('left', os.statvfs('/')[3])
"""


@pytest.mark.full
def test_a_full_flash_is_refused_and_nothing_of_the_attempt_stays(blank):
    wait_for(lambda: mpremote_or_none(blank, "exec", FILL), "the flash to be full")
    run = run_cli("deploy", "--port", str(blank.link))
    assert run.returncode == 1
    assert run.stderr.splitlines()[-1].startswith("mirrormount: "), run.stderr
    ask = "import os; print(*os.listdir('/'))"
    names = wait_for(lambda: mpremote_or_none(blank, "exec", ask), "the files' names").split()
    assert "measurements" in names
    assert not [name for name in names if name.endswith(".new") or name == "mountfw.journal"]
