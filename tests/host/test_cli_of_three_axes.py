"""The commands on a board whose board file has a third axis."""

import pytest
from three_axes import make_firmware, switch_on

from mirrormount.cli import main
from mirrormount.device.mount import Mount
from mirrormount.transport.link import Link


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Runs a command on a virtual board with three axes that has just started: (exit status, output, errors)."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "settings"))
    make_firmware(tmp_path)
    monkeypatch.setattr(Mount, "open", lambda _address: Mount(Link(switch_on(tmp_path))))

    def run(*words: str) -> tuple[int, str, str]:
        capsys.readouterr()
        status = main.main([*words])
        return status, *capsys.readouterr()

    return run


def test_status_has_a_line_for_each_axis(run):
    status, out, _ = run("status")
    assert status == 0
    assert [line.split(":")[0] for line in out.splitlines()[1:]] == ["x", "y", "axis3"]


def test_a_step_and_a_move_of_the_third_axis_say_where_it_is(run):
    assert run("step", "axis3", "2") == (0, "axis3: moved +2 steps, now at +2 (unknown)\n", "")
    assert run("move", "axis3", "-1")[:2] == (0, "axis3: moved -1 steps, now at -1 (unknown)\n")


def test_a_jog_of_the_third_axis_ends_after_its_seconds(run):
    status, out, _ = run("jog", "axis3", "0.5", "--seconds", "0.2")
    assert status == 0
    assert out.startswith("axis3: ")


def test_config_shows_and_changes_settings_of_the_third_axis(run):
    assert run("config", "set", "axis3.pulse_us", "150000", "--save")[0] == 0
    assert run("config", "get", "axis3.pulse_us")[1] == "150000\n"
    shown = run("config", "get")[1].splitlines()
    assert {line.split(".")[0] for line in shown} == {"x", "y", "axis3"}


def test_check_tests_the_third_axis_too(run):
    out = run("check")[1]
    for name in ("x", "y", "axis3"):
        assert f"{name} emergency stop: not pressed" in out and f"{name} keep-alive: this one moves" in out


def test_an_axis_that_the_board_lacks_is_one_line_of_error(run):
    status, out, err = run("step", "axis4", "1")
    assert (status, out) == (1, "")
    assert err == "mirrormount: there is no axis 'axis4': this mount has x, y, axis3\n"


@pytest.mark.parametrize("name", ["z", "axis", "axis0", "axis33", "3"])
def test_a_name_that_no_axis_can_have_is_wrong_usage(run, capsys, name):
    with pytest.raises(SystemExit) as ended:
        run("step", name, "1")
    assert ended.value.code == 2
    assert f"'{name}' is no axis" in capsys.readouterr().err
