"""Named positions, what can be undone, and the log of what moved: with a board in a process of its own."""

import csv
import io
import sqlite3
import subprocess
import sys

import pytest
from full_disk import run_with_room
from served import ServedBoard, run_cli, wait_for

from mirrormount.device import motion_log, presets, records
from mirrormount.device.mount import Mount
from mirrormount.device.presets import Place, SeenSpot
from mirrormount.device.status import parse_status
from mirrormount.errors import BadFile, CannotWrite, MoveEnded, NotKept, PositionDoubtful
from mirrormount.supervise.supervisor import Supervisor


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "data"))
    return tmp_path / "data"


@pytest.fixture
def mount():
    with Mount.open("virtual://?speed=max") as mount:
        yield mount


@pytest.fixture
def board_with_switches(tmp_path):
    with ServedBoard(tmp_path / "switches", "--bench", "switches") as board:
        yield board


# ---- named positions


def test_a_kept_position_is_gone_back_to_by_all_axes(mount):
    mount.x.step(3)
    mount.y.move_to(-1.25)
    mount.presets.keep("good")
    mount.x.step(4)
    mount.y.step(1)
    mount.presets.keep("later")
    assert mount.presets.back("good").name == "good"
    assert (mount.x.position, mount.y.position) == (3, -1.25)
    assert mount.presets.back().name == "later", "without a name it is the one that was kept last"
    assert (mount.x.position, mount.y.position) == (7, -0.25)
    mount.presets.remove("later")
    assert [preset.name for preset in mount.presets.all()] == ["good"]


def test_a_position_of_another_board_is_not_gone_to_and_its_board_is_named(mount):
    mount.presets.keep("good")
    with Mount.open("virtual://?speed=max") as other:
        other.session.board.identity = other.identity.replace(other.board_id, "0011223344556677")
        with pytest.raises(NotKept, match=f"0011223344556677; kept: none.*the board {mount.board_id} has one"):
            other.presets.back("good")


@pytest.mark.parametrize("known", [True, False], ids=["counted", "unknown"])
def test_after_zero_a_position_is_refused_until_zero_is_undone(mount, known):
    mount.x.zero(5) if known else mount.x.step(5)
    mount.presets.keep("good")
    mount.x.step(2)
    mount.x.zero()
    with pytest.raises(PositionDoubtful, match=r"x: its 0 was set since \(Zero\)"):
        mount.presets.back("good")
    assert mount.x.position == 0
    mount.x.step(1)
    assert "+8 steps as before Zero of " in mount.presets.undo_zero()
    mount.presets.back("good")
    assert mount.x.position == 5


def test_after_a_restart_nothing_is_moved_unless_the_person_is_sure(mount):
    mount.x.zero(5)
    mount.presets.keep("good")
    mount.reset()
    with pytest.raises(PositionDoubtful, match="restarted since"):
        mount.presets.back("good")
    with pytest.raises(PositionDoubtful, match="restarted since"):
        mount.presets.undo_zero()
    mount.presets.back("good", sure=True)
    assert mount.x.position == 5


@pytest.mark.parametrize(
    ("then", "now", "restarted", "doubted"),
    [
        ("homed", "homed", True, False),
        ("homed", "estimated", False, False),
        ("counted", "estimated", False, False),
        ("unknown", "unknown", False, False),
        ("unknown", "unknown", True, True),
        ("unknown", "counted", False, True),
        ("counted", "counted", True, True),
        ("counted", "homed", False, True),
        ("homed", "counted", False, True),
    ],
)
def test_what_a_certainty_says_of_a_kept_position(mount, monkeypatch, then, now, restarted, doubted):
    step = mount.x.ask_whole("XP?", "XD?", "XI?")
    preset = presets.Preset("good", 0.0, mount.status().boot_id - restarted, {mount.x.number: Place(0, then, step, 0)})
    place = Place(0, now, step, 0)
    monkeypatch.setattr(presets.Presets, "_place", lambda *_: place)
    assert bool(mount.presets.doubts(preset)) == doubted


def test_after_homing_a_position_of_before_is_refused_also_when_the_axis_has_moved_since():
    with Mount.open("virtual://?speed=max&bench=switches") as mount:
        mount.x.switches = 3
        mount.x.zero(4)
        mount.presets.keep("good")
        mount.x.home()
        mount.x.pulse(1_000)
        assert mount.status().x.certainty == "estimated"
        with pytest.raises(PositionDoubtful, match="it was homed since"):
            mount.presets.back("good")
        with pytest.raises(PositionDoubtful, match="it was homed since"):
            mount.presets.undo_zero()


def test_the_log_invents_no_motion_after_a_restart(mount):
    log = mount.session.motion_log = motion_log.MotionLog(mount.board_id)
    mount.status()
    mount.x.step(2)
    log.lose()
    mount.session.motion_log = None
    mount.x.define(0)  # in the place of a restart
    log.see(mount.status())
    log.close()
    assert [(motion.from_steps, motion.to_steps) for motion in motion_log.read()] == [(0, 2)]


def test_settings_are_undone_by_the_motor_and_not_by_the_name_of_its_axis():
    with Mount.open("virtual://?speed=max", x_axis=2) as mount:
        mount.x.pulse_us = 150_000  # of motor 2
    with Mount.open("virtual://?speed=max", x_axis=1) as mount:
        mount.y.pulse_us = 150_000  # the same motor
        mount.undo_settings()
        assert (mount.x.pulse_us, mount.y.pulse_us) == (200_000, 200_000)


def test_a_position_whose_steps_were_others_is_refused(mount):
    mount.presets.keep("good")
    mount.x.step_duty = 200
    with pytest.raises(PositionDoubtful, match=r"x: its steps were others .*255.* now .*200"):
        mount.presets.back("good")


def test_the_shell_keeps_lists_goes_back_and_says_why_not(board):
    port = "--port", str(board.link)
    assert run_cli("keep", *port).stdout == "no position of this board is kept\n"
    assert run_cli("step", "x", "1", *port).returncode == 0
    assert ": x +1.000 (unknown), y +0.000 (unknown)\n" in run_cli("keep", "good", *port).stdout
    run_cli("step", "x", "1", *port)
    back = run_cli("back", *port)
    assert back.stdout == "good: x: +1.000 steps (unknown), y: +0.000 steps (unknown)\n"
    assert back.stderr.startswith("note: back to good, kept ")
    assert run_cli("keep", "1st", *port).returncode == 1
    wrong = run_cli("back", "god", *port)
    assert (wrong.returncode, wrong.stderr.count("\n")) == (1, 1)
    assert "kept: good); did you mean good?\n" in wrong.stderr


# ---- undo of settings


def test_a_change_of_settings_is_undone_and_told_and_undone_again():
    port = "virtual://?speed=max"
    with Mount.open(port) as mount:
        mount.apply({"x": {"velocity": 3}, "y": {"pulse_us": 150_000}})
        changed = mount.settings()
        mount.recall(factory=True)
        assert mount.undo_settings() == {"x.velocity": 3, "y.pulse_us": 150_000}
        assert mount.settings() == changed
        assert set(mount.undo_settings()) == {"x.velocity", "y.pulse_us"}
    run = run_cli("config", "undo", "--port", port)
    assert (run.returncode, run.stdout.splitlines()[0]) == (0, "x.velocity = 3")


def test_without_a_change_there_is_nothing_to_undo(mount):
    for undo in (mount.undo_settings, mount.presets.undo_zero):
        with pytest.raises(NotKept):
            undo()


def test_a_change_that_cannot_be_kept_is_made_and_told(mount, folder, caplog):
    folder.write_text("")  # no folder
    mount.x.zero(3)
    mount.x.velocity = 3
    assert (mount.x.position, mount.x.velocity) == (3, 3)
    assert [record.message.partition(":")[0] for record in caplog.records] == 2 * [
        "what this changes is not kept for an undo, nor known to `mirrormount back`"
    ]


# ---- the log


def logged(*words: str) -> list[dict[str, str]]:
    run = run_cli("log", "--csv", *words)
    assert run.returncode == 0, run.stderr
    return list(csv.DictReader(io.StringIO(run.stdout)))


def test_what_moved_is_logged_with_whom_how_far_and_how_it_ended(board):
    with Mount.open(str(board.link)) as mount:
        mount.session.motion_log.client = "page 1 (127.0.0.1)"
        mount.x.step(2)
        mount.x.pulse(300)  # over before a status can see it move
        mount.y.jog(0.5)
        mount.sleep(0.3)
        mount.stop()
        mount.x.zero()
        identity = mount.board_id
    rows = logged()
    assert [(row["name"], row["how"], row["certainty"]) for row in rows] == [
        ("x", "done", "unknown"),
        ("x", "done", "unknown"),
        ("y", "stopped: its program asked for it", "unknown"),
        ("x", "set, not moved", "counted"),
    ]
    assert (rows[0]["from_steps"], rows[0]["to_steps"]) == ("0.0", "2.0")
    assert {row["board"] for row in rows} == {identity}
    assert all(row["who"].startswith("page 1 (127.0.0.1), ") for row in rows)
    assert logged("--board", "no such id") == [] == logged("--since", "2999-01-01")
    assert "x: +0.000 to +2.000 steps, done (unknown), by page 1" in run_cli("log", "--since", "1h").stdout


def test_a_stop_is_logged_with_its_cause_and_the_next_motion_without(board):
    with Supervisor(str(board.link)) as supervisor, supervisor.join("camera loop", lost=print) as loop:
        loop.take_control()
        jog = loop.jog("x", 0.5)
        wait_for(lambda: supervisor.status and supervisor.status.moving, "the jog")
        supervisor.worker.stop("a beam shutter has closed")
        with pytest.raises(MoveEnded):
            jog.wait()
        loop.take_control()
        loop.step("x", 1).wait()
    assert [row["how"] for row in logged()] == ["stopped: a beam shutter has closed", "done"]


def test_a_homing_is_logged_as_one_for_its_0_is_another_afterwards(board_with_switches):
    with Mount.open(str(board_with_switches.link)) as mount:
        mount.x.switches = 3
        mount.x.home()
        mount.x.step(1)
    assert [row["how"] for row in logged()] == ["homed: 0 is there since", "done"]


def test_a_spot_is_not_kept_with_a_position_where_it_was_not_seen(mount):
    spot = SeenSpot("camera", 1.0, 2.0, 0.1, 0.1, 640, 480)
    mount.x.step(2)
    assert mount.presets.keep("here", spot=spot, seen_at={1: 0.0, 2: 2.0}).spot == spot
    assert mount.presets.keep("good", spot=spot, seen_at={1: 0.0, 2: 0.0}).spot is None
    assert [preset.spot for preset in mount.presets.all()] == [spot, None]


def test_a_step_after_a_search_that_was_stopped_is_no_homing(board_with_switches):
    with Mount.open(str(board_with_switches.link)) as mount:
        mount.x.switches = 3
        mount.x.start_homing()
        mount.stop()
        mount.x.step(2)
    *_, step = logged()
    assert step["how"] == "done"


def test_the_version_of_a_database_changes_with_each_change_of_it(mount):
    seen = [records.version(presets.FILE)]
    for work in (mount.presets.all, lambda: mount.presets.keep("good"), mount.presets.all, mount.x.zero):
        work()
        seen.append(records.version(presets.FILE))
    assert seen[0] == seen[1] == b"" and seen[2] == seen[3] and len({*seen}) == 3


def test_of_a_supervised_mount_the_log_names_the_client(board):
    with Supervisor(str(board.link)) as supervisor, supervisor.join("camera loop", lost=print) as loop:
        loop.take_control()
        loop.step("x", 2).wait()
    (row,) = logged()
    assert (row["to_steps"], row["who"].partition(",")[0]) == ("2.0", "camera loop")


def test_the_newest_motion_is_listed_first_and_for_other_programs_last(board):
    for n in "+1", "+2":
        run_cli("step", "x", n, "--port", str(board.link))
    assert [line.partition(" to ")[2][:6] for line in run_cli("log").stdout.splitlines()] == ["+3.000", "+1.000"]
    assert [row["to_steps"] for row in logged()] == ["1.0", "3.0"]


def test_the_log_knows_the_mounts_of_the_table_by_their_names(board, folder):
    with Mount.open(str(board.link)) as mount:
        mount.x.step(1)
        identity = mount.board_id
    (folder / "table.toml").write_text(
        f'[mounts.near]\nboard = "{identity}"\n[mounts.far]\nboard = "{identity}"\nx_axis = 3\n'
    )
    assert "  near  x: +0.000 to +1.000 steps" in run_cli("log").stdout
    (row,) = logged("--board", "near")
    assert row["board"] == identity and logged("--board", identity[:4]) == [row]
    assert logged("--board", "far") == []
    assert "; did you mean near?" in run_cli("log", "--board", "neer").stderr
    (folder / "table.toml").write_text(f'[mounts.near]\nport = "{board.link}"\n')
    assert "near is named by its port" in run_cli("log", "--board", "near").stderr


def test_two_programs_log_at_once_and_nothing_is_lost():
    code = (
        "from mirrormount.device.motion_log import MotionLog\n"
        "from mirrormount.device.status import parse_status\n"
        "log = MotionLog('a board')\n"
        "for n in range(200):\n"
        "    log.see(parse_status(f'1,2,0|{n * 1000},0,1,0,0,1|0,0,1,0,0,1', 2))\n"
        "log.close()\n"
    )
    programs = [subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE) for _ in range(2)]
    assert [program.communicate()[1] for program in programs] == [b"", b""]
    assert len(list(motion_log.read())) == 2 * 199


def test_the_log_keeps_the_latest(monkeypatch):
    monkeypatch.setattr(motion_log, "MOST", 10)
    log = motion_log.MotionLog("a board")
    for n in range(30):
        log.see(motion_log_status(n))
    log.close()
    assert [motion.to_steps for motion in motion_log.read()] == [float(n) for n in range(20, 30)]


def motion_log_status(steps: int):
    return parse_status(f"1,2,0|{steps * 1000},0,1,0,0,1|0,0,1,0,0,1", 2)


def test_a_full_disk_costs_a_warning_and_no_motion(board):
    run = run_with_room(0, "step", "x", "2", "--port", str(board.link))
    assert (run.returncode, run.stdout) == (0, "x: moved +2 steps, now at +2 (unknown)\n")
    assert run.stderr.startswith("what moves is not being logged: cannot use ") and run.stderr.count("\n") == 1
    kept = run_with_room(0, "keep", "good", "--port", str(board.link))
    assert (kept.returncode, kept.stderr.count("\n")) == (1, 1)
    assert logged() == []


@pytest.mark.parametrize("content", [b"no database " * 500, b"SQLite format 3\0" + bytes(4000)])
def test_a_damaged_file_costs_a_warning_and_no_motion(board, folder, content):
    folder.mkdir()
    for name in (motion_log.FILE, presets.FILE):
        (folder / name).write_bytes(content)
    run = run_with_room(1 << 30, "step", "x", "2", "--port", str(board.link))
    assert (run.returncode, run.stdout) == (0, "x: moved +2 steps, now at +2 (unknown)\n")
    assert "what moves is not being logged" in run.stderr and "damaged" in run.stderr
    for words in (("log",), ("keep", "good", "--port", str(board.link)), ("back", "--port", str(board.link))):
        refused = run_cli(*words)
        assert (refused.returncode, refused.stderr.count("\n")) == (1, 1) and "move it away" in refused.stderr
    assert (folder / presets.FILE).read_bytes() == content


def test_an_entry_that_is_no_position_is_one_error(mount):
    mount.presets.keep("good")
    with sqlite3.connect(records.path(presets.FILE)) as file:
        file.execute("update positions set entry = '[1]'")
    file.close()
    with pytest.raises(BadFile, match="damaged"):
        mount.presets.all()


def test_a_database_that_another_program_has_locked_is_an_error_and_no_wait_without_end(mount, monkeypatch):
    monkeypatch.setattr(records, "_BUSY_S", 0.01)
    mount.presets.keep("good")
    with records.opened(presets.FILE, "", write=True), pytest.raises(CannotWrite, match="locked"):
        mount.presets.keep("better")


def test_a_stop_needs_no_database():
    code = (
        "import sys; from mirrormount.device.mount import Mount; from mirrormount.cli import main;"
        "main.parser(['stop']); mount = Mount.open('virtual://'); mount.stop(); mount.close();"
        "print('sqlite3' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "False\n"
