"""A Mount on a board with a third axis, and what its lines look like with two, three and four of them."""

import argparse
import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest
import transcript
from served import run_cli
from three_axes import make_firmware, switch_on
from transcript import AT_REST, IDENTITY, TranscriptPort, opened, second_pair, sent, started

from mirrormount import errors
from mirrormount.cli import main, motion
from mirrormount.cli.config import export, import_, load
from mirrormount.device import calibration
from mirrormount.device.calibration import Scale, Step
from mirrormount.device.mount import Mount
from mirrormount.device.settings import ENCODER
from mirrormount.device.status import Limits
from mirrormount.transport.link import Link

THREE_AT_REST = f"{AT_REST}|0,0,0,0,1,1"


@pytest.fixture
def root(tmp_path, monkeypatch) -> Path:
    """A folder with the files of a board with three axes."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "settings"))
    make_firmware(tmp_path)
    return tmp_path


@pytest.fixture
def mount(root) -> Iterator[Mount]:
    """A mount on that board."""
    with Mount(Link(switch_on(root))) as mount:
        yield mount


def third_is_driven(mount: Mount) -> list[bool]:
    """The writes to the enable pin of the third motor: on or off, repeated values left out."""
    writes = [duty > 0 for _, pin, duty in mount.link.port.simulation.edges if pin == "m3_en"]
    return [on for before, on in zip([False, *writes], writes, strict=False) if on != before]


@pytest.mark.parametrize("x_axis", [1, 2])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_axes_are_in_the_boards_order_and_x_and_y_by_the_number_of_x(count, x_axis):
    status = "|".join(["7,100,0", *(f"{number}000,0,0,0,1,1" for number in range(1, count + 1))])
    port = TranscriptPort([("!", None), ("*IDN?", IDENTITY), *[("XS?", status)] * (count + 1)])
    mount = Mount(Link(port), x_axis=x_axis)
    assert [axis.number for axis in mount.axes] == list(range(1, count + 1))
    assert [axis.position for axis in mount.axes] == list(range(1, count + 1))
    assert (mount.x.number, mount.y.number) == (x_axis, 3 - x_axis)
    assert list(mount.by_name) == ["x", "y", "axis3", "axis4"][:count]
    assert [axis.name for axis in mount.axes[2:]] == ["axis3", "axis4"][: count - 2]
    mount.close()


def test_the_second_pair_of_axes_is_a_mount_of_its_own_and_takes_no_frames():
    mount = second_pair(polls=2)
    assert (mount.x.number, mount.y.number) == (4, 3)
    assert list(mount.by_name) == ["x", "y", "axis1", "axis2"]
    assert mount.status().y.position == 3
    with pytest.raises(errors.NotSupported, match="motors 1 and 2"):
        mount.drive(10, 0)
    mount.close()


def test_a_drive_command_of_the_second_pair_is_refused_as_a_drive_is(monkeypatch):
    monkeypatch.setattr(motion, "open_mount", lambda args: contextlib.closing(second_pair()))
    with pytest.raises(errors.NotSupported, match="motors 1 and 2"):
        motion.drive(argparse.Namespace(m1="100", m2="0", seconds=None))


@pytest.mark.parametrize(("x_axis", "why"), [(3, "the board has 2 axes"), (5, "1 to 4"), (True, "1 to 4")])
def test_x_is_an_axis_of_a_pair_that_the_board_has(x_axis, why):
    with pytest.raises(errors.BadValue, match=why):
        Mount(Link(TranscriptPort([("!", None), ("*IDN?", IDENTITY), ("XS?", AT_REST)])), x_axis=x_axis)


@pytest.mark.parametrize("status", ["7,100,0", "7,100,0|0,0,0,0,1,1", f"{AT_REST}|0,0,0,0,1", f"{AT_REST}|"])
def test_less_than_two_axes_or_a_part_of_one_is_no_mount(status):
    with pytest.raises(errors.NotAMount, match="not a mount's status"):
        Mount(Link(TranscriptPort([("!", None), ("*IDN?", IDENTITY), ("XS?", status)])))


def test_a_board_that_has_another_number_of_axes_than_before_is_to_be_opened_again():
    mount = opened([("XS?", THREE_AT_REST)])
    with pytest.raises(errors.NotAMount, match="had 2 axes and has 3 now: open it again"):
        mount.status()


def test_a_step_of_the_third_axis_waits_for_that_axis(monkeypatch):
    monkeypatch.setattr(transcript, "AT_REST", THREE_AT_REST)
    moving = f"{AT_REST}|500,1,1,0,0,1"
    lines = [
        ("3XP?;3VA?", "200000; 2.00"),
        *started("3PR1"),
        ("XS?", moving),
        ("XS?", THREE_AT_REST),
        ("3XE?", "1,1,200000"),
    ]
    mount = opened(lines)
    mount.axis("axis3").step(1)
    mount.close()


def test_an_error_of_the_third_axis_has_its_name(monkeypatch):
    monkeypatch.setattr(transcript, "AT_REST", THREE_AT_REST)
    mount = opened(
        [*sent("XK500;3PR1", error="304, AXIS 3 POSITIVE END-STOP REACHED"), ("TB?", "0, NO ERROR DETECTED")]
    )
    with pytest.raises(errors.BoardError, match="304: axis3 positive end-stop reached"):
        mount.send("3PR1")
    mount.close()


def test_the_third_axis_moves_and_the_others_do_not(mount):
    third = mount.axes[2]
    third.step(2)
    assert third_is_driven(mount) == [True, False, True, False]
    assert [axis.position for axis in mount.axes] == [0, 0, 2]
    assert repr(third).startswith("<Axis axis3: +2.000 steps")
    assert str(mount.status()).startswith("x: +0.000") and "; axis3: +2.000 steps" in str(mount.status())


def test_a_stop_ends_the_third_axis_and_a_silence_too(mount):
    mount.axes[2].jog(0.5)
    assert mount.status().moving
    mount.stop()
    assert not mount.status().moving and third_is_driven(mount) == [True, False]
    mount.axes[2].jog(0.5, feed=False)
    mount.link.sleep(1)
    assert mount.status().by_name["axis3"].reason == 7  # keep-alive lost


def test_settings_of_all_axes_are_read_written_exported_and_imported(mount, tmp_path):
    mount.apply({"axis3": {"pulse_us": 50_000}, "x": {"step_duty": 100}})
    mount.axes[2].limits = Limits(-5, 5)
    mount.axes[2].take_up_us = 1000
    mine = mount.settings()
    assert list(mine) == ["x", "y", "axis3"]
    assert (mine["axis3"]["pulse_us"], mine["axis3"]["soft_maximum"], mine["axis3"]["take_up_us"]) == (50_000, 5, 1000)
    assert mine["y"]["pulse_us"] == 200_000
    export(mount, str(tmp_path / "mine.toml"))
    mount.recall(factory=True)
    assert mount.settings() != mine
    import_(mount, load(str(tmp_path / "mine.toml")))
    assert mount.settings() == mine
    with pytest.raises(errors.BoardError, match="axis3 positive soft limit"):
        mount.axes[2].step(6)


def test_each_setting_is_a_property_of_each_axis(mount):
    mine = mount.settings()
    for axis in mount.axes:
        assert {name: getattr(axis, name) for name in mine[axis.name]} == mine[axis.name]
        assert {name: getattr(axis, name) for name in ENCODER} == dict.fromkeys(ENCODER, 0)  # there is none
    mount.axes[2].pulse_us = 50_000
    mount.x.velocity = 2.5
    assert (mount.axes[2].pulse_us, mount.x.velocity, mount.y.velocity) == (50_000, 2.5, mine["y"]["velocity"])
    with pytest.raises(errors.BadValue, match=r"x\.pulse_us is within 200"):
        mount.x.pulse_us = 199
    with pytest.raises(AttributeError):
        mount.x.pulse_ms = 1


def test_contradictory_settings_of_the_third_axis_are_refused_and_nothing_changes(mount):
    before = mount.settings()
    for wanted, why in (
        ({"soft_minimum": 5, "soft_maximum": 4}, "axis3.soft_minimum 5 is above its maximum 4"),
        ({"velocity": 1999}, "axis3.velocity 1999 is above"),
        ({"pulse_us": 199}, "axis3.pulse_us is within"),
    ):
        with pytest.raises(errors.BadValue, match=why):
            mount.apply({"x": {"step_duty": 7}, "axis3": wanted})
    assert mount.settings() == before


def test_a_setting_of_an_axis_that_the_board_has_not_is_refused_before_anything_is_sent():
    mount = opened([])
    with pytest.raises(errors.BadValue, match="settings are those of x and of y; there is no 'axis3'"):
        mount.apply({"axis3": {"pulse_us": 1000}})
    with pytest.raises(errors.BadValue, match="there is no axis 'axis3': this mount has x, y"):
        mount.axis("axis3")
    mount.close()


def test_the_shell_moves_and_shows_the_third_axis(root, monkeypatch, capsys):
    monkeypatch.setattr("mirrormount.device.mount.open_port", lambda _: switch_on(root))
    assert main.main(["step", "axis3", "2", "--port", "virtual://"]) == 0
    assert capsys.readouterr().out == "axis3: moved +2 steps, now at +2 (unknown)\n"
    assert main.main(["status", "--port", "virtual://"]) == 0
    _, *axes = capsys.readouterr().out.splitlines()
    assert [line.partition(": +0.000 steps")[0] for line in axes] == ["x", "y", "axis3"]


@pytest.mark.parametrize("name", ["axis4", "axis2", "z"])
def test_an_axis_that_is_not_there_is_one_line_in_the_shell(name):
    run = run_cli("step", name, "1", "--port", "virtual://?speed=max")
    assert run.returncode
    assert f"'{name}'" in run.stderr.splitlines()[-1] and "Traceback" not in run.stderr


@pytest.mark.parametrize("verb", [("get",), ("set", "1000")])
def test_a_setting_of_an_axis_that_is_not_there_is_one_line_in_the_shell(verb):
    run = run_cli("config", verb[0], "axis3.pulse_us", *verb[1:], "--port", "virtual://?speed=max")
    assert run.returncode == 1 and run.stderr.startswith("mirrormount: ") and run.stderr.count("\n") == 1
    assert "'axis3'" in run.stderr and "fault" not in run.stderr


def test_an_angle_of_the_third_axis_is_by_its_own_scale(mount):
    calibration.write(mount.board_id, {3: Scale(0.1, None, Step(200_000, 255)), 2: Scale(0.2, 0.2, Step(200_000, 255))})
    assert mount.axes[2].move_by(0.3, "mrad") == pytest.approx(0.3)
    assert mount.axes[2].position == 3
    with pytest.raises(errors.NotCalibrated, match=r"axis3: no scale in the negative direction.*\.axis3\]"):
        mount.axes[2].move_by(-0.3, "mrad")
