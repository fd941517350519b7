"""Settings: all that are named are changed, or none; they are shown, saved, exported and imported."""

import io
import os
import threading
import tomllib

import pytest

from mirrormount import errors
from mirrormount.cli import main
from mirrormount.cli.config import export, import_, load
from mirrormount.device.mount import Mount
from mirrormount.device.settings import ENCODER, SETTINGS
from mirrormount.device.status import Limits
from mirrormount.errors import SettingRefused


@pytest.fixture
def mount():
    with Mount.open("virtual://?speed=max") as mount:
        yield mount


OTHER = {
    "inverted": 1,
    "switches": 3,
    "motor_type": 0,
    "pulse_us": 150_000,
    "step_duty": 200,
    "velocity": 3.25,
    "acceleration": 10,
    "run_duty": 100,
    "start_duty": 70,
    "pwm_hz": 25,
    "slow_decay": 1,
    "take_up_us": 250_000,
    "checking": 8,
    "soft_minimum": -40,
    "soft_maximum": 60,
    "run_limit_ms": 5000,
    "search_limit_ms": 60_000,
}


def test_every_setting_can_be_changed_and_is_read_as_it_was_written(mount):
    before = mount.settings()
    declared = [name for name in SETTINGS if name not in ENCODER]
    assert list(OTHER) == declared, "add it to OTHER, in the order of settings.py"
    assert list(before["x"]) == declared
    mount.apply({"x": OTHER})
    assert mount.settings() == {"x": OTHER, "y": before["y"]}


def test_saved_settings_are_there_again_after_the_factorys(mount):
    factory = mount.settings()
    mount.apply({"x": OTHER, "y": {"pulse_us": 1000}})
    mine = mount.settings()
    mount.save()
    mount.recall(factory=True)
    assert mount.settings() == factory
    mount.recall()
    assert mount.settings() == mine


def test_a_setting_that_is_set_to_be_kept_is_there_at_the_next_start(tmp_path, capsys):
    port = ("--port", f"virtual://?speed=max&files={tmp_path}")
    assert main.main(["config", "set", "--save", "x.pulse_us", "150000", *port]) == 0
    assert main.main(["config", "set", "x.run_duty", "99", *port]) == 0
    assert main.main(["config", "get", "x.pulse_us", *port]) == 0
    assert main.main(["config", "get", "x.run_duty", *port]) == 0
    first, second, *values = capsys.readouterr().out.splitlines()
    assert "saved on the board" in first and "until the board restarts" in second
    assert values == ["150000", "255"]


@pytest.mark.parametrize("words", [("set", "--save", "x.pulse_us", "150000"), ("save",), ("import", "--save", "-")])
def test_what_is_saved_on_a_board_that_ends_with_the_command_is_not_called_kept(monkeypatch, tmp_path, capsys, words):
    gone = "it is a virtual board that ends with this command: virtual://?files=FOLDER keeps what it saves"
    for options, told in (("", True), (f"&files={tmp_path}", False)):
        monkeypatch.setattr("sys.stdin", io.StringIO("[y]\nvelocity = 1.5\n"))
        assert main.main(["config", *words, "--port", f"virtual://?speed=max{options}"]) == 0
        said = capsys.readouterr().out
        assert "saved on the board" in said and (gone in said) is told


@pytest.mark.parametrize("machine", ["cpython", "circuitpython"])
def test_what_save_calls_saved_on_a_served_board_outlives_its_being_killed(serve, tmp_path, capsys, machine):
    options = ("--machine", machine, "--files", str(tmp_path / "files"))
    board = serve(*options)
    assert main.main(["config", "set", "--save", "x.pulse_us", "150000", "--port", board.tcp]) == 0
    board.kill()
    assert main.main(["config", "get", "x.pulse_us", "--port", serve(*options).tcp]) == 0
    assert capsys.readouterr().out == "x.pulse_us = 150000 (saved on the board)\n150000\n"


def test_saved_settings_outlive_a_power_cut(tmp_path):
    address = f"virtual://?speed=max&files={tmp_path}"
    with Mount.open(address) as mount:
        mount.apply({"x": OTHER})
        mount.save()
        mine = mount.settings()
    with Mount.open(address) as mount:
        assert mount.settings() == mine


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pulse_us", 199),
        ("pulse_us", 2_000_001),
        ("pulse_us", 1000.5),
        ("pulse_us", "1000"),
        ("pulse_us", True),
        ("pulse_us", None),
        ("velocity", 2.005),
        ("velocity", 0),
        ("velocity", float("nan")),
        ("switches", 8),
        ("checking", 4),
        ("soft_minimum", 1_000_001),
        ("speed", 1),
    ],
)
def test_one_wrong_setting_refuses_all_by_name_and_nothing_is_sent(mount, name, value):
    before = mount.settings()
    with pytest.raises(errors.BadValue, match=rf"y\.{name}"):
        mount.apply({"x": {"pulse_us": 1000}, "y": {name: value}})
    assert mount.settings() == before


@pytest.mark.parametrize("wanted", [{"z": {}}, {"x": 3}, [1], {"x": {"soft_minimum": 5, "soft_maximum": 4}}])
def test_what_are_no_settings_is_refused(mount, wanted):
    with pytest.raises(errors.BadValue):
        mount.apply(wanted)


def test_a_velocity_that_the_pulses_do_not_fit_in_changes_nothing(mount):
    mount.x.zero()
    mount.x.step(1)
    with pytest.raises(errors.BadValue, match=r"x\.velocity 500 is above 9\.9"):
        mount.apply({"x": {"pulse_us": 100_000, "velocity": 500}})
    assert mount.x.status().certainty == "counted"


def test_what_the_board_refuses_is_named_and_all_are_put_back(mount):
    before = mount.settings()
    with pytest.raises(errors.SettingRefused, match=r"y\.switches = 4.*135.*as they were"):
        mount.apply({"x": {"pulse_us": 1000, "inverted": 1}, "y": {"step_duty": 7, "switches": 4}})
    assert mount.settings() == before


def test_settings_are_refused_while_the_axis_moves_and_the_move_goes_on(mount):
    before = mount.settings()
    mount.x.step(3, wait=False)
    with pytest.raises(errors.SettingRefused, match="214"):
        mount.apply({"x": {"pulse_us": 1000, "run_duty": 9}})
    assert mount.x.wait().steps == 3
    assert mount.settings() == before


def test_a_setting_that_is_so_already_is_not_written_again(mount):
    mount.x.step(1)
    mount.x.zero(5)
    mount.apply({"x": {"pulse_us": 200_000}})  # another pulse would make the position an estimate
    assert mount.x.status().certainty == "counted"


def test_soft_limits_are_a_pair_and_whether_they_are_checked(mount):
    mount.apply({"x": {"checking": 1}})
    mount.x.limits = Limits(-3, 7)
    assert mount.x.limits == Limits(-3, 7, checked=True)
    assert mount.settings()["x"]["checking"] == 9
    with pytest.raises(errors.BadValue, match="forbids everything"):
        mount.x.limits = Limits(7, -3)
    mount.x.limits = Limits(-3, 7, checked=False)
    assert mount.settings()["x"]["checking"] == 1


def test_take_up_is_read_and_set(mount):
    mount.y.take_up_us = 300_000
    assert mount.y.take_up_us == 300_000
    assert mount.x.take_up_us == 0
    with pytest.raises(errors.BadValue, match=r"y\.take_up_us"):
        mount.y.take_up_us = -1


def test_what_is_exported_can_be_imported(mount, tmp_path, capsys):
    mount.apply({"x": OTHER})
    file = tmp_path / "mine.toml"
    export(mount, str(file))
    mine = mount.settings()
    assert tomllib.loads(file.read_text()) == mine
    mount.recall(factory=True)
    import_(mount, load(str(file)))
    assert mount.settings() == mine
    export(mount, "-")
    assert tomllib.loads(capsys.readouterr().out.split("restarts; to keep it: mirrormount config save)\n")[1]) == mine


def test_settings_come_from_standard_input_too(mount, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("[y]\nvelocity = 1.5\n"))
    import_(mount, load("-"))
    assert mount.settings()["y"]["velocity"] == 1.5


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_waited_for_with_a_word_and_read_once(tmp_path, capsys):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_text, args=("[x]\nvelocity = 1.5\n",), daemon=True)
    writer.start()
    assert main.main(["config", "import", str(pipe), "--port", "virtual://?speed=max"]) == 0
    writer.join()
    out, err = capsys.readouterr()
    assert out.startswith("1 settings taken") and err.startswith(f"note: {pipe} is a pipe: waiting")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no settings"),
        ("[x]\npulse_us = 1e", "line 2"),
        ("[x]\npulse_us = 3", r"x\.pulse_us"),
        ("[z]\n", "no 'z'"),
        ("[[x]]\n", r"\[x\] is not a table of settings"),
        ("x = 3\n", r"\[x\] is not a table of settings"),
        ("[x]\ntilt = 3", r"x\.tilt"),
        ("[x]\npulse_us = 2020-01-01", r"x\.pulse_us"),
        ("[x]\npulse_us = 0x" + "F" * 900, "too long"),  # the parser takes it, and nothing can print longer ones
        ("[x]\na = [\n" + "1,\n" * (1 << 17) + "]", "more than 262144 bytes"),
        ("a." * 100_000 + "a = 1", "a line of more than 1000"),  # the parser would take an hour
        ("[x" + ".a" * 100 + "]", "nested too deeply"),
        ('[x]\npulse_us = """\n' + "A\n" * 1000 + '"""', r"x\.pulse_us is a number, not '.{1,60}$"),
    ],
)
def test_a_file_that_is_wrong_is_one_line_that_names_it_before_a_port_is_opened(tmp_path, capsys, text, says):
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    assert main.main(["config", "import", str(file), "--port", "/dev/does-not-exist"]) == 1
    err = capsys.readouterr().err
    assert str(file) in err and err.count("\n") == 1
    with pytest.raises(errors.BadFile, match=says):
        load(str(file))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("get", "x.speed"), "no setting 'x.speed'"),
        (("set", "pulse_us", "3"), "no setting 'pulse_us'"),
        (("get", "x.speed"), "zero_angle (from counts_per_step on: of an axis with an encoder)"),
        (("set", "x.pulse_us", "fast"), "x.pulse_us is a whole number, such as 1000, without an exponent, not 'fast'"),
        (("set", "x.take_up_us", "1e3"), "x.take_up_us is a whole number, such as 1000, without an exponent"),
        (("set", "x.velocity", "1e1"), "x.velocity is a number, such as 1.5, without an exponent, not '1e1'"),
        (("set", "x.velocity", "1.5e0"), "x.velocity is a number, such as 1.5, without an exponent, not '1.5e0'"),
        (("set", "x.pulse_us", "3"), "within 200"),
        (("set", "x.velocity", "1_0"), "without an exponent, not '1_0'"),
        (("set", "x.velocity", "0." + "0" * 400 + "1"), "x.velocity is a number"),
        (("import", "missing.toml"), "no such file"),
        (("import", ""), "FILE is an empty text"),
        (("export", ""), "FILE is an empty text"),
    ],
)
def test_wrong_words_are_one_line_before_a_port_is_opened(words, says, capsys):
    assert main.main(["config", *words, "--port", "/dev/does-not-exist"]) == 1
    err = capsys.readouterr().err
    assert says in err and err.count("\n") == 1


def test_a_place_that_cannot_be_written_is_one_line(mount, tmp_path):
    (tmp_path / "file").touch()
    for place in (tmp_path, tmp_path / "file" / "mine.toml", tmp_path / "absent" / "mine.toml"):
        with pytest.raises(errors.CannotWrite):
            export(mount, str(place))
    assert not (tmp_path / "absent").exists()


def test_get_and_set_from_the_shell(capsys):
    port = ["--port", "virtual://?speed=max"]
    assert main.main(["config", "get", "x.pulse_us", *port]) == 0
    assert capsys.readouterr().out == "200000\n"
    assert main.main(["config", "get", *port]) == 0
    shown = capsys.readouterr().out
    assert all(f"{axis}.{name} = " in shown for axis in "xy" for name in SETTINGS if name not in ENCODER)
    assert main.main(["config", "set", "y.velocity", "1.25", *port]) == 0
    assert "y.velocity = 1.25 (until the board restarts" in capsys.readouterr().out
    for words in (["save"], ["restore"], ["restore", "--factory"]):
        assert main.main(["config", *words, *port]) == 0


def test_a_search_by_stall_above_what_the_gears_bear_is_set_and_warned_of(caplog):
    with Mount.open("virtual://?speed=max&encoder=motor") as mount:
        mount.apply({"x": {"stall_duty": 100}})
        assert not caplog.records
        mount.apply({"x": {"stall_duty": 128}})
        assert mount.x.stall_duty == 128
    (record,) = caplog.records
    assert record.getMessage().startswith("x.stall_duty 128: above 100 a stall may break the gears")


def test_a_board_that_cannot_change_its_pwm_refuses_and_keeps_its_settings(tmp_path):
    with Mount.open(f"virtual://?speed=max&machine=circuitpython&files={tmp_path}") as mount:
        before = mount.settings()
        for wanted in ({"slow_decay": 1}, {"pwm_hz": 25}):
            with pytest.raises(SettingRefused, match="x not fitted"):
                mount.apply({"x": wanted})
        assert mount.settings() == before
