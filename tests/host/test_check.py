"""The self-test: it says what is wrong and what to do, fails when something is, and moves only if told to."""

import re

import pytest

from mirrormount import errors
from mirrormount.cli import check as check_module
from mirrormount.cli import main
from mirrormount.cli.check import Wrong, run_checks
from mirrormount.device.axis import Axis
from mirrormount.device.mount import Mount

ADDRESS = "virtual://?speed=max&bench=switches"


@pytest.fixture
def mount():
    mount = Mount.open(ADDRESS)  # run_checks() closes it
    yield mount
    mount.close()


def check(mount: Mount, capsys, *, move: bool = False, ask=None) -> tuple[dict[str, str], bool]:
    """({what: line}, did it pass?)"""
    passed = True
    try:
        run_checks(lambda: mount, move=move, ask=ask)
    except errors.CheckFailed:
        passed = False
    lines = capsys.readouterr().out.splitlines()
    return {line[11:].partition(":")[0]: line for line in lines}, passed


def drives(mount: Mount) -> list[tuple[int, str, int]]:
    return [edge for edge in mount.link.port.simulation.edges if edge[1].endswith("_en") and edge[2]]


def test_a_good_mount_passes_and_nothing_moves(mount, capsys):
    lines, passed = check(mount, capsys)
    assert passed
    assert not any(line.startswith("FAILED") for line in lines.values()), lines
    assert lines["x keep-alive"].startswith("not tested") and "--move" in lines["x keep-alive"]
    assert lines["firmware"].startswith("ok")
    assert not drives(mount)


def test_with_move_each_axis_makes_its_steps_and_ends_near_where_it_was(mount, capsys):
    lines, passed = check(mount, capsys, move=True, ask=lambda _: True)
    assert passed, lines
    for what in ("motion", "one step forward", "one step back", "stop in a move", "keep-alive"):
        assert lines[f"x {what}"].startswith("ok") and lines[f"y {what}"].startswith("ok")
    assert {pin for _, pin, _ in drives(mount)} == {"m1_en", "m2_en"}
    bench = mount.link.port.simulation.bench
    assert not any(bench.duties().values())
    assert max(map(abs, bench.spot_mm())) < 10  # three steps, and four there and back


def test_pulses_that_nobody_saw_move_the_mirror_are_not_called_ok(mount, capsys):
    mount.link.port.simulation.bench.horizontal.jammed = True
    lines, passed = check(mount, capsys, move=True)
    assert passed, lines
    for what in ("one step forward", "one step back", "stop in a move", "keep-alive"):
        assert lines[f"x {what}"].startswith("not seen") and "motion not verified" in lines[f"x {what}"]


def test_a_person_who_sees_no_motion_fails_the_axis_and_its_pulses_are_not_called_ok(mount, capsys):
    mount.link.port.simulation.bench.horizontal.jammed = True
    lines, passed = check(mount, capsys, move=True, ask=lambda question: not question.startswith("x: did"))
    assert not passed
    assert lines["x motion"].startswith("FAILED") and lines["x one step forward"].startswith("not seen")
    assert lines["y motion"].startswith("ok") and lines["y one step forward"].startswith("ok")


def test_a_take_up_of_the_backlash_is_not_taken_for_a_wrong_pulse(mount, capsys):
    mount.apply({"x": {"take_up_us": 280_000}, "y": {"take_up_us": 280_000}})
    lines, passed = check(mount, capsys, move=True)
    assert passed, lines


def test_end_stops_that_are_fitted_are_looked_at(mount, capsys):
    mount.send("1XL3;2XL3")
    lines, passed = check(mount, capsys)
    assert passed and lines["x end-stops"].startswith("ok")


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        ({"m2_sw_pos"}, "step x -20"),
        ({"m2_sw_neg"}, "step x 20"),
        ({"m2_sw_pos", "m2_sw_neg"}, "both are active"),
    ],
)
def test_a_broken_wire_of_a_switch_fails_with_what_to_do(mount, capsys, broken, says):
    mount.send("1XL3;2XL3")
    mount.link.port.simulation.bench.broken |= broken
    lines, passed = check(mount, capsys)
    assert not passed
    assert lines["x end-stops"].startswith("FAILED") and says in lines["x end-stops"]
    assert lines["y end-stops"].startswith("ok")


def test_end_stops_that_are_ignored_are_not_called_good(mount, capsys):
    mount.send("2XL3;2ZH1")
    lines, _ = check(mount, capsys)
    assert lines["x end-stops"].startswith("not tested") and "x.checking 0" in lines["x end-stops"]


def test_errors_that_wait_are_shown_and_fail(mount, capsys):
    mount.ask("AT;XK?")
    lines, passed = check(mount, capsys)
    assert not passed
    assert "6 COMMAND DOES NOT EXIST" in lines["errors waiting"]


def test_damaged_settings_fail_with_what_to_do(tmp_path, capsys):
    address = f"virtual://?speed=max&files={tmp_path}"
    with Mount.open(address) as mount:
        mount.save()
    file = tmp_path / "mountfw.settings"
    file.write_bytes(file.read_bytes().replace(b"200000", b"200001", 1))
    lines, passed = check(Mount.open(address), capsys)
    assert not passed
    assert lines["settings"].startswith("FAILED") and "config import" in lines["settings"]
    assert lines["errors waiting"].startswith("ok")


def test_a_pressed_emergency_stop_fails_and_drives_nothing(mount, capsys, monkeypatch):
    send = mount.session._send

    def pressed(line: str, *gate) -> str:
        if "PR" in line:
            raise errors.BoardError(243, "AXIS 2 EMERGENCY STOP")
        return send(line, *gate)

    monkeypatch.setattr(mount.session, "_send", pressed)
    lines, passed = check(mount, capsys)
    assert not passed and "*RST" in lines["x emergency stop"]
    assert not drives(mount)


def test_other_files_than_this_hosts_are_told(mount, capsys, monkeypatch):
    monkeypatch.setattr("mirrormount.deploy.firmware.known_hashes", lambda: iter(["0" * 64]))
    lines, passed = check(mount, capsys)
    assert passed and lines["firmware"].startswith("not tested") and "mirrormount deploy" in lines["firmware"]


def test_a_step_that_drives_for_another_time_than_it_should_is_wrong(mount, monkeypatch):
    ask_whole = mount.x.ask_whole
    monkeypatch.setattr(Axis, "ask_whole", lambda _, *q: [198_500, 0] if q == ("XP?", "XB?") else ask_whole(*q))
    with pytest.raises(Wrong, match="not 198500 us"):
        check_module.one_step(mount.x, 1)


def test_a_keep_alive_that_does_not_act_is_wrong_and_the_axis_is_at_rest_after_it(mount, monkeypatch):
    send = mount.send
    monkeypatch.setattr(mount, "send", lambda line: send(re.sub(r"^XK\d+;", "", line)))
    with pytest.raises(Wrong, match="keep-alive lost"):
        check_module.keep_alive_ends_motion(mount, mount.x)
    assert not mount.status().moving


def test_the_moves_that_are_ended_have_drive_when_they_end(mount, capsys):
    """In the rest after a step there is none: an end there shows nothing of the motor."""
    check(mount, capsys, move=True)
    assert [pin for _, pin, _ in drives(mount)] == ["m2_en"] * 4 + ["m1_en"] * 4


def test_a_move_that_ends_before_the_motor_has_drive_is_no_test(mount, monkeypatch):
    monkeypatch.setattr(check_module, "_rest", lambda *_: None)
    mount.x.step(1)
    with pytest.raises(Wrong, match="nothing was tested"):
        check_module.stop_in_motion(mount, mount.x)


def test_a_move_into_a_switch_fails_and_the_other_axis_is_still_tested(mount, capsys):
    mount.send("2XL3")
    train = mount.link.port.simulation.bench.horizontal
    train.screw_rev = train.shaft_rev = 2.0
    lines, passed = check(mount, capsys, move=True)
    assert not passed
    assert lines["x one step forward"].startswith("FAILED") and "end-stop" in lines["x one step forward"]
    assert lines["y keep-alive"].startswith("not seen")


def test_no_mount_is_one_line_and_status_1(capsys):
    assert main.main(["check", "--port", "/dev/does-not-exist"]) == 1
    said = capsys.readouterr()
    assert said.out.startswith("FAILED     port: /dev/does-not-exist: there is no such port")
    assert said.err.count("\n") == 1


def test_the_shell_command_ends_with_0_when_all_is_well(capsys):
    assert main.main(["check", "--port", "virtual://?speed=max"]) == 0
    assert "stop: answered" in capsys.readouterr().out


def test_after_a_stop_by_another_program_nothing_more_moves_and_the_rest_is_not_tested(mount, capsys, monkeypatch):
    step = Axis.step

    def stopped_in_it(axis, n, *arguments, **options):
        if n < 0:
            mount.session.stop_for_another_program()
        step(axis, n, *arguments, **options)

    monkeypatch.setattr(Axis, "step", stopped_in_it)
    with pytest.raises(errors.CheckFailed, match="stopped by `mirrormount stop`: the rest was not tested"):
        run_checks(lambda: mount, move=True)
    told = capsys.readouterr().out.splitlines()
    assert told[-1].startswith("FAILED     x one step back")
    assert len(drives(mount)) == 1
