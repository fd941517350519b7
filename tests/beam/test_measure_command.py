"""`mirrormount measure` on the virtual table: report, numbers, and every end that is not good."""

import json
import re

import pytest

from mirrormount.cli import main
from mirrormount.errors import CannotWrite
from mirrormount_beam.camera import Limits, Picture, checked
from mirrormount_beam.cli import measure
from mirrormount_beam.errors import CameraGone
from mirrormount_beam.experiments import steps
from mirrormount_beam.experiments.rig import MountRig
from mirrormount_sim.bench import BACKLASH_X_MRAD, BACKLASH_Y_MRAD, STEP_X_MRAD, STEP_Y_MRAD

SEED = ("--virtual", "--profile", "smooth", "--seed", "5")
pytestmark = pytest.mark.usefixtures("own_folder")


def test_a_square_finds_what_the_demo_finds_and_is_told_with_page_and_numbers(tmp_path, capsys, tables):
    assert main.main(["measure", "square", *SEED]) == 0
    out = capsys.readouterr().out
    assert "x.side_right" in out and "urad of the beam" in out
    numbers = json.loads((tmp_path / "measure-square.json").read_text())
    assert numbers["partial"] == ""
    found, urad_of_px = numbers["estimates"], 0.05 / 400 * 1e6
    for name, mrad in (
        ("x.step", STEP_X_MRAD),
        ("y.step", STEP_Y_MRAD),
        ("x.open", BACKLASH_X_MRAD),
        ("y.open", -BACKLASH_Y_MRAD),
        ("x.open_with_take_up", 0.0),
        ("y.open_with_take_up", 0.0),
    ):  # as `mirrormount demo` sees them; here the laser drifts, which the error has in it
        error_urad = found[name]["standard_error"] * urad_of_px
        assert found[name]["value"] * urad_of_px == pytest.approx(1000 * mrad, abs=3 * error_urad), name
        assert error_urad < 100, name
    page = (tmp_path / "measure-square.html").read_text()
    assert "of the beam" in page and "of the mirror" in page
    assert "<svg" in page and "data:image/png;base64," in page
    assert "http" not in page.split("<svg")[0], "the page needs nothing from elsewhere"


class Slower:
    """A camera the frames of which are 3 s apart from the moment on at which slow is set."""

    def __init__(self, camera):
        self._camera, self.slow = camera, False

    def __getattr__(self, name):
        return getattr(self._camera, name)

    def frames(self):
        return checked(self._pictures(), self._camera.name, self._camera.size, Limits())

    def _pictures(self):
        behind_s = 0.0
        for frame in self._camera.frames():
            behind_s += 3.0 * self.slow
            yield Picture(frame.image, frame.time_s + behind_s)


FAULTS = {
    "unplugged": (lambda camera: setattr(camera, "plugged", False), "unplugged"),
    "black": (lambda camera: setattr(camera, "black", True), "all pixels have one value"),
    "repeating": (lambda camera: setattr(camera, "frozen", True), "no fresh frame|same picture"),
    "of another size": (lambda camera: camera.sensor.resize(320, 240), "a frame has 320 x 240 pixels"),
    "slow": (lambda camera: setattr(camera, "slow", True), "frames a second"),
}


@pytest.mark.parametrize("experiment", measure.EXPERIMENTS)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_camera_that_fails_in_mid_measurement_is_one_line_motors_off_and_a_partial_report(
    fault, experiment, tmp_path, capsys, tables, monkeypatch
):
    """It fails when the mount has moved, at the fifth look or later."""
    happen, says = FAULTS[fault]
    looks = []

    def driven():
        (simulation,) = tables[0].simulations
        return {name: duty for _, name, duty in simulation.edges if name.endswith("_en")}

    class Cut(measure.SpotObserver):
        def __init__(self, camera):
            super().__init__(Slower(camera) if fault == "slow" else camera, settle_s=0.05)

        def observe(self, *args):
            looks.append(1)
            if len(looks) >= 5 and (driven() or experiment == "drift"):
                happen(self.camera)
            return super().observe(2)

    monkeypatch.setattr(measure, "SpotObserver", Cut)
    assert main.main(["measure", experiment, *SEED]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "virtual camera 1" in err
    assert re.search(says, err)
    numbers = json.loads((tmp_path / f"measure-{experiment}.json").read_text())
    assert len(numbers["readings"]) >= 4
    assert numbers["partial"] in err
    assert "Ended early" in (tmp_path / f"measure-{experiment}.html").read_text()
    assert not any(driven().values())


@pytest.mark.parametrize("experiment", measure.EXPERIMENTS)
def test_no_setting_of_the_board_is_ever_changed_so_a_killed_measurement_leaves_none(
    experiment, tables, monkeypatch, capsys
):
    """Each look asks for all settings: at none of them is one different from what it was."""
    seen = []

    class Asking(measure.SpotObserver):
        def observe(self, *args):
            seen.append(rigs[0].mount.settings())
            if len(seen) == 12:
                raise CameraGone("gone")
            return super().observe(*args)

    rigs = []

    def made(mount, *args):
        rigs.append(MountRig(mount, *args))
        mount.apply({"x": {"take_up_us": 123_456}, "y": {"velocity": 1.25}})
        before.append(mount.settings())
        return rigs[-1]

    before = []
    monkeypatch.setattr(measure, "SpotObserver", Asking)
    monkeypatch.setattr(measure, "MountRig", made)
    assert main.main(["measure", experiment, *SEED]) == 1
    assert len(seen) == 12
    assert all(settings == before[0] for settings in seen)
    capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("drift", *SEED, "--minutes", "0"), "--minutes is 0.5 or more"),
        (("drift", *SEED, "--minutes", "1e-9"), "--minutes is 0.5 or more"),
        (("steps", *SEED, "--minutes", "5"), "--minutes is of the experiment drift"),
        (("drift", *SEED, "--apply"), "--apply is of the experiments steps, backlash, pulses"),
        (("steps", *SEED, "--camera", "3"), "cameras 1 and 2"),
        (("steps", *SEED, "--step", "0", "px"), "--step is more than 0"),
        (("steps", *SEED, "--mm-per-px", "0.05", "--step", "1e6", "px"), "too large for a picture of 640 x 480"),
        (("steps", *SEED, "--step", "1", "inch"), "the unit of --step is px, mm"),
        (("steps", *SEED, "--step", "many", "px"), "--step is a number"),
        (("square", *SEED, "--step", "1", "px"), "--step is of the experiment steps"),
        (("steps", *SEED, "--mm-per-px", "0.05", "--step", "250", "urad"), "--step in urad needs a scale"),
        (("steps", *SEED, "--axes", "x,z"), "z"),
        (("steps", *SEED, "--distance", "100"), "--distance needs --mm-per-px"),
        (("steps", *SEED, "--distance-error", "1"), "--distance-error needs --mm-per-px"),
        (("steps", *SEED, "--incidence", "30"), "--incidence needs --mm-per-px"),
        (("steps", *SEED, "--mm-per-px", "1", "--distance-error", "1"), "--distance-error needs --distance"),
        (("steps", *SEED, "--mm-per-px", "1", "--incidence", "90"), "0 to less than 90 degrees, not 90"),
        (("steps", *SEED, "--mm-per-px", "-1"), "more than 0"),
        (("steps", *SEED, "--report", "none/here.html"), "no such folder"),
        (("steps", *SEED, "--report", ""), "cannot write ."),
        (("steps", *SEED, "--report", "/proc/here.html"), "cannot write /proc/here.html"),
        (("steps", *SEED, "--report", "/dev/null"), "cannot write /dev/null: it is a link, or not a file"),
        (("steps", "--seed", "5"), "add --virtual"),
        (
            ("steps", "--port", "virtual://", "--camera", "virtual-table://#2"),
            "virtual-table://#2 sees the mounts of its",
        ),
    ],
)
def test_wrong_input_is_one_line_and_nothing_is_opened(words, says, capsys):
    assert main.main(["measure", *words]) == 1
    out, err = capsys.readouterr()
    assert says in err and err.count("\n") == 1
    assert "report" not in out


@pytest.mark.parametrize("option", ["--report", "--json"])
def test_a_file_that_is_no_report_is_not_replaced_and_nothing_is_measured(option, tmp_path, capsys):
    rows = tmp_path / "map.csv"
    rows.write_text("number,time_s")
    assert main.main(["measure", "drift", *SEED, "--minutes", "0.5", option, str(rows)]) == 1
    out, err = capsys.readouterr()
    assert "map.csv: a file of that name exists, and is no report; name another one" in err and "report" not in out
    assert rows.read_text() == "number,time_s"


def test_a_report_is_replaced_by_the_next_one(tmp_path, capsys):
    for _ in range(2):
        assert main.main(["measure", "drift", *SEED, "--minutes", "0.5"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"measure-drift.html", "measure-drift.json"}
    capsys.readouterr()


@pytest.mark.parametrize("encoder", ["motor", "shaft"])
def test_the_loop_of_a_virtual_mount_with_encoders_is_closed_before_it_is_measured(encoder, found, tables, tmp_path):
    assert main.main(["measure", "backlash", *SEED, "--axes", "x", "--encoder", encoder]) == 0
    settings = json.loads((tmp_path / "measure-backlash.json").read_text())["settings"]
    assert [settings[axis]["closed_loop"] for axis in "xy"] == [1, 1]
    counts = {"motor": 277, "shaft": 96}[encoder]
    assert [settings[axis]["counts_per_step"] for axis in "xy"] == pytest.approx([counts] * 2, rel=0.02)


def test_a_drift_is_told_in_angles_of_the_beam_where_there_is_a_scale(tmp_path, capsys):
    words = ["measure", "drift", *SEED, "--minutes", "0.5"]
    assert main.main(words) == 0
    (walk,) = (line for line in capsys.readouterr().out.splitlines() if "x.walk" in line)
    px, urad = (float(part.split()[0]) for part in walk.split("x.walk")[1].split("= "))
    assert walk.endswith("urad/sqrt(s) of the beam")
    assert urad == pytest.approx(px * 125, rel=0.05), "0.05 mm a pixel at 400 mm"
    assert "µrad/√s" in (tmp_path / "measure-drift.html").read_text()
    assert main.main([*words, "--mm-per-px", "0.1"]) == 0
    assert "mm/sqrt(s)" in capsys.readouterr().out


@pytest.mark.parametrize("opens", [False, True])
def test_the_last_line_names_the_page_and_a_browser_opens_it_only_if_asked(opens, tmp_path, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda url: not opened.append(url))
    assert main.main(["measure", "drift", *SEED, "--minutes", "0.5", *["--open"] * opens]) == 0
    assert capsys.readouterr().out.endswith("\nopen measure-drift.html\n")
    assert opened == [(tmp_path / "measure-drift.html").as_uri()] * opens


def test_ctrl_c_keeps_what_was_measured(tmp_path, capsys, monkeypatch, tables):
    class Interrupted(measure.SpotObserver):
        count = 0

        def observe(self, *args):
            self.count += 1
            if self.count == 5:
                raise KeyboardInterrupt
            return super().observe(*args)

    monkeypatch.setattr(measure, "SpotObserver", Interrupted)
    assert main.main(["measure", "drift", *SEED]) == 130
    out, err = capsys.readouterr()
    assert out.startswith("partial report: measure-drift.html") and out.endswith("\nopen measure-drift.html\n")
    assert err == "mirrormount: stopped\n"
    numbers = json.loads((tmp_path / "measure-drift.json").read_text())
    assert numbers["partial"] == "stopped by Ctrl-C" and len(numbers["readings"]) == 4
    assert "4 readings of the spot. The JSON file has each of them." in (tmp_path / "measure-drift.html").read_text()


def test_a_page_without_a_result_shows_the_readings(tmp_path, monkeypatch, tables):
    def interrupted(rig, result, _tell):
        steps.Log(rig, result).rest()
        raise KeyboardInterrupt

    monkeypatch.setattr(measure.backlash, "run", interrupted)
    assert main.main(["measure", "backlash", *SEED]) == 130
    page = (tmp_path / "measure-backlash.html").read_text()
    assert "None yet" in page
    assert page.count("<h2>All readings: the spot") == page.count("<svg") == 2


@pytest.mark.parametrize(("failing", "other"), [("write_page", "numbers"), ("write_json", "report")])
def test_a_report_that_cannot_be_written_takes_neither_the_other_file_nor_the_result(
    failing, other, found, tables, monkeypatch, tmp_path, capsys
):
    def fail(path, *_):
        raise CannotWrite(f"cannot write {path}: No space left on device")

    monkeypatch.setattr(measure, failing, fail)
    assert main.main(["measure", "backlash", *SEED]) == 1
    out, err = capsys.readouterr()
    assert f"{other}: measure-backlash." in out and "251000 ± 900 us" in out
    assert "No space left on device" in err
    assert len(list(tmp_path.glob("measure-backlash.*"))) == 1
