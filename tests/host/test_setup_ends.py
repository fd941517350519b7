"""`mirrormount setup` that ends before its last question, however it does: motors off, and nothing changed."""

import contextlib
import signal
import subprocess
import sys

import pytest
from full_disk import run_with_room
from served import HANG_S, run_cli
from setup_person import Person, set_up

from mirrormount import errors
from mirrormount.cli import main, setup
from mirrormount.cli.setup import run_course
from mirrormount.device import calibration, settings
from mirrormount_sim.bench import SCREEN_MM

pytestmark = pytest.mark.usefixtures("own_folder")


@pytest.mark.parametrize("question", ["May it", "Which way", "Press the", "Distance", "Where is", "Save this"])
def test_input_that_ends_leaves_nothing_changed(mount, question):
    mount.apply({"x": {"inverted": 1, "take_up_us": 1234}})
    before = mount.settings()
    with pytest.raises(errors.SetupEnded, match=r"input has ended: nothing was saved") as ended:
        set_up(mount, {question: [EOFError()]}, distance_mm=SCREEN_MM)
    assert "\n" not in str(ended.value)
    assert mount.settings() == before
    assert not calibration.path().exists()


def test_ctrl_c_leaves_the_motors_off_and_nothing_changed(mount):
    mount.apply({"x": {"inverted": 1}})
    before = mount.settings()
    person = Person(mount, {"Where is": [KeyboardInterrupt()]}, distance_mm=SCREEN_MM)
    with pytest.raises(KeyboardInterrupt):
        run_course(mount, person, person.say)
    assert "nothing was saved" in person.said[-1]
    assert mount.settings() == before
    assert not any(mount.link.port.simulation.bench.duties().values())


@pytest.mark.parametrize(("name", "status"), [("SIGTERM", 143), ("SIGHUP", 129), ("SIGINT", 130)])
def test_a_signal_ends_setup_and_leaves_nothing_changed(mount, monkeypatch, name, status):
    before = mount.settings()
    person = Person(mount, {"Which way": ["left"]})
    signals = [getattr(signal, name)]

    def answer(question: str) -> str:
        if person.asked and mount.settings() != before and signals:
            signal.raise_signal(signals.pop())
        return person(question)

    monkeypatch.setattr(setup, "open_mount", lambda _args: contextlib.nullcontext(mount))
    monkeypatch.setattr(setup, "run_course", lambda mount: run_course(mount, answer, person.say))
    assert main.main(["setup"]) == status
    assert not signals and "nothing was saved" in person.said[-1]
    assert mount.settings() == before
    assert not any(mount.link.port.simulation.bench.duties().values())


def test_ctrl_c_while_the_settings_are_put_back_leaves_nothing_changed(mount, monkeypatch):
    before = mount.settings()
    put_back, presses = settings.put_back, [KeyboardInterrupt()]

    def interrupted(*args):
        if presses:
            raise presses.pop()
        put_back(*args)

    monkeypatch.setattr(settings, "put_back", interrupted)
    with pytest.raises(KeyboardInterrupt):
        set_up(mount, {"Which way": ["left", EOFError()]})
    assert mount.settings() == before


def test_setup_whose_output_nobody_reads_any_more_leaves_nothing_changed(mount):
    before = mount.settings()
    person = Person(mount)

    def say(_text: str) -> None:
        if mount.settings() != before:
            raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        run_course(mount, person, say)
    assert mount.settings() == before


def test_a_byte_that_is_no_text_is_a_wrong_answer_and_asked_again(monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "utf-8:strict")
    words = ("setup", "--port", "virtual://?speed=max")
    run = subprocess.run(
        [sys.executable, "-m", "mirrormount", *words], input=b"\xff\n\xc3", capture_output=True, timeout=HANG_S
    )
    assert run.returncode == 1
    assert run.stdout.count(b"please answer yes or no") == 2
    assert run.stderr.count(b"\n") == 1 and b"the input has ended: nothing was saved" in run.stderr


def test_a_stop_by_another_program_in_a_question_ends_setup_before_the_next_step(mount):
    before = mount.settings()
    person = Person(mount)

    def answer(question: str) -> str:
        if "Which way" in question:
            mount.session.stop_for_another_program()
        return person(question)

    with pytest.raises(errors.MoveEnded, match="stopped before it began"):
        run_course(mount, answer, person.say)
    assert mount.settings() == before
    assert person.said[-1].startswith("nothing was saved")


def test_a_no_at_the_end_saves_nothing(mount):
    before = mount.settings()
    person = set_up(mount, {"Save this": ["no"]})
    assert "nothing was saved" in person.said[-1]
    assert mount.settings() == before
    assert not calibration.path().exists()


def test_a_damaged_calibration_file_is_told_before_anything_moves(mount):
    calibration.path().write_text("x = = 3")
    with pytest.raises(errors.BadFile, match="line 1"):
        set_up(mount)
    assert not [e for e in mount.link.port.simulation.edges if e[1].endswith("_en") and e[2]]
    assert calibration.path().read_text() == "x = = 3"


def test_a_value_that_cannot_be_written_again_is_told_before_anything_is_asked(mount):
    calibration.path().write_text(f"[{mount.board_id}]\nmeasured = 2026-05-01\n")
    person = Person(mount)
    with pytest.raises(errors.BadFile, match=r"measured = 2026-05-01 is no number.* move the file away") as damage:
        run_course(mount, person, person.say)
    assert str(calibration.path()) in str(damage.value)
    assert not person.asked
    assert calibration.path().read_text().endswith("measured = 2026-05-01\n")


@pytest.mark.skipif(sys.platform == "win32", reason="RLIMIT_FSIZE")
def test_a_disk_without_room_is_told_before_anything_is_asked():
    run = run_with_room(1000, "setup", "--port", "virtual://?speed=max")
    assert (run.returncode, run.stdout) == (1, "")
    assert run.stderr.startswith(f"mirrormount: cannot write {calibration.path()}: ") and run.stderr.count("\n") == 1


def test_without_anybody_to_answer_setup_is_one_line_and_moves_nothing(tmp_path):
    run = run_cli("setup", "--port", f"virtual://?speed=max&edges={tmp_path / 'edges'}")
    assert run.returncode == 1
    assert run.stderr.count("\n") == 1 and "the input has ended: nothing was saved" in run.stderr
    assert "_en" not in (tmp_path / "edges").read_text()
