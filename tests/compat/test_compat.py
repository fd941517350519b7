"""Facts about tools/compat: how it reads pins, and that what fails is told."""

import importlib
import importlib.util
import subprocess
import sys
from pathlib import Path

import checks
import pytest
from checks import Checks, Trial
from pins import Drive, drives, told
from place import WAYS

COMPAT = Path(__file__).parent.parent.parent / "tools" / "compat"
_spec = importlib.util.spec_from_file_location("compat_run", COMPAT / "run.py")  # tools/bench has a run.py, too
assert _spec and _spec.loader
run = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(run)


def edges(*pins: tuple[int, str, int]) -> list[dict]:
    return [{"t_us": t, "pin": pin, "duty" if pin.endswith("_en") else "level": value} for t, pin, value in pins]


STEP_BACK = [(0, "m1_neg", 1), (10, "m1_en", 65535), (20_010, "m1_en", 0), (20_020, "m1_neg", 0)]


def test_a_drive_is_the_time_that_its_enable_is_high_and_its_sign_that_of_the_leg():
    both = edges(*STEP_BACK, (30_000, "m2_pos", 1), (30_010, "m2_en", 20_000))
    assert drives(both) == [Drive(1, -1, 10, 20_000), Drive(2, 1, 30_010)]
    assert told(drives(both)) == "axis 1: 1 x -20 ms; axis 2: 1 x still drives"


def test_drives_of_both_axes_may_overlap():
    both = edges(
        (0, "m1_pos", 1), (0, "m2_neg", 1), (1, "m1_en", 9), (2, "m2_en", 9), (5_001, "m1_en", 0), (7_002, "m2_en", 0)
    )
    assert [drive.ms for drive in drives(both)] == [5, -7]


def test_a_change_of_duty_is_no_new_drive():
    assert len(drives(edges((0, "m1_pos", 1), (1, "m1_en", 9), (2, "m1_en", 8), (3, "m1_en", 0)))) == 1


@pytest.mark.parametrize("legs", [(0, 0), (1, 1)])
def test_an_enable_without_exactly_one_leg_is_refused(legs):
    with pytest.raises(ValueError, match="legs"):
        drives(edges((0, "m1_pos", legs[0]), (0, "m1_neg", legs[1]), (1, "m1_en", 65535)))


class FakePlace:
    """A board that does nothing but drive, if told to."""

    address, way = "", "tcp"
    runs = False
    closed = 0

    def close(self) -> None:
        self.closed += 1

    def mark(self) -> None:
        pass

    def driving(self) -> bool:
        return self.runs


class FakeDriver:
    """A driver of that board, of which one error waits if told to."""

    queue: tuple[str, ...] = ()
    closed = 0

    def connect(self, *_: object) -> list[str]:
        return [*self.queue, "0"]

    def disconnect(self, _driver: object) -> None:
        self.closed += 1

    def send(self, driver: list[str], line: str) -> str:
        return (driver.pop(0) if len(driver) > 1 else "0") if line == "TE?" else ""


def refuse(t: Trial) -> None:
    t.driver[:] = ["108", "0"]


def run_away(t: Trial) -> None:
    t.place.runs = True


@pytest.mark.parametrize(("body", "why"), [(refuse, "errors"), (run_away, "driven")])
def test_a_check_that_leaves_an_error_or_a_driven_motor_fails(body, why):
    listed = Checks()
    listed.add("call")(body)
    kind = FakeDriver()
    with pytest.raises(AssertionError, match=why):
        Trial(kind, FakePlace()).run(listed[0])
    assert kind.closed == 1


def test_errors_that_waited_before_a_check_do_not_fail_it():
    listed = Checks()
    listed.add("call")(lambda t: None)
    kind = FakeDriver()
    kind.queue = ("60", "62")
    Trial(kind, FakePlace()).run(listed[0])


def test_run_prints_a_line_with_what_the_pins_did():
    pytest.importorskip("pylablib", reason="pylablib-lightweight is not installed here")
    words = ["--driver", "pylablib", "--machine", "cpython", "--way", "tcp", "--only", "move_to"]
    done = subprocess.run([sys.executable, str(COMPAT / "run.py"), *words], capture_output=True, text=True, timeout=600)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[2:] == [
        "| pylablib | tcp | cpython | move_to | axis 1: nothing; axis 2: 2 x +20 ms, 3 x -20 ms | ok |"
    ]


class NotInstalled(FakeDriver):
    """A driver whose published package is not there."""

    NAME, CHECKS = "fake", Checks()

    def connect(self, *_: object) -> list[str]:
        raise ModuleNotFoundError("No module named 'published'")


def test_a_driver_that_is_not_installed_is_told_and_no_failure(monkeypatch):
    kind = NotInstalled()
    kind.CHECKS.add("call")(lambda t: None)
    place = FakePlace()
    monkeypatch.setattr(checks, "Place", lambda *_: place)
    assert [row[-1] for row in run.rows(kind, "tcp", "cpython", "")] == ["not run: No module named 'published'"]
    assert place.closed == 1


def test_each_driver_file_can_be_read_without_its_package_and_has_checks_for_its_ways():
    assert {"instrumentkit", "newfocus8742", "pylablib"} <= set(run.drivers())
    for name in run.drivers():
        kind = importlib.import_module(f"driver_{name}")
        assert name == kind.NAME
        assert set(kind.WAYS) <= set(WAYS) and all(set(check.ways) & set(kind.WAYS) for check in kind.CHECKS)
        assert set(kind.WAYS) <= {way for check in kind.CHECKS for way in check.ways}


def test_run_refuses_a_driver_that_has_no_file():
    done = subprocess.run([sys.executable, str(COMPAT / "run.py"), "--driver", "none"], capture_output=True, text=True)
    assert done.returncode == 2 and "pylablib" in done.stderr and "Traceback" not in done.stderr
