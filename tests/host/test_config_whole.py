"""Settings are changed all or none: at a signal, a lost answer, a lost board, a refusal on the way."""

import contextlib
import signal

import pytest

from mirrormount import errors
from mirrormount.cli import config, main
from mirrormount.device import settings
from mirrormount.device.mount import Mount


@pytest.fixture
def mount():
    with Mount.open("virtual://?speed=max") as mount:
        yield mount


def at_the_run_duty(mount, monkeypatch, act) -> None:
    """Call act() once, in place of the line that sets a run duty, which comes after the pulse."""
    send, acts = mount.session.send, [act]

    def sent(line):
        if "XV" in line and not line.endswith("?") and acts:
            acts.pop()()
        return send(line)

    monkeypatch.setattr(mount.session, "send", sent)


@pytest.mark.parametrize(
    ("name", "status", "says"),
    [
        ("SIGINT", 130, "mirrormount: stopped; the settings are as they were\n"),
        ("SIGTERM", 143, "mirrormount: ended by SIGTERM; the settings are as they were\n"),
    ],
)
def test_a_signal_in_the_middle_of_an_import_puts_all_back(mount, monkeypatch, tmp_path, capsys, name, status, says):
    before = mount.settings()
    file = tmp_path / "mine.toml"
    file.write_text("[x]\npulse_us = 1000\n[y]\npulse_us = 1000\nrun_duty = 9\n")

    def twice():
        for _ in range(2):
            signal.raise_signal(getattr(signal, name))

    at_the_run_duty(mount, monkeypatch, twice)
    monkeypatch.setattr(config, "open_mount", lambda _args: contextlib.nullcontext(mount))
    assert main.main(["config", "import", str(file)]) == status
    assert capsys.readouterr().err == says
    assert mount.settings() == before


def test_ctrl_c_in_the_middle_of_saving_says_that_the_settings_are_in_use(mount, monkeypatch, capsys):
    def interrupted(_mount):
        raise KeyboardInterrupt

    monkeypatch.setattr(Mount, "save", interrupted)
    monkeypatch.setattr(config, "open_mount", lambda _args: contextlib.nullcontext(mount))
    assert main.main(["config", "set", "--save", "x.run_duty", "9"]) == 130
    said = capsys.readouterr().err
    assert said == "mirrormount: stopped; the board uses the settings, and may not have saved them\n"


def test_an_answer_that_is_lost_in_the_middle_of_a_change_puts_all_back(mount, monkeypatch):
    def lost():
        raise errors.NoAnswer("no answer within 1 s")

    before = mount.settings()
    at_the_run_duty(mount, monkeypatch, lost)
    with pytest.raises(errors.NoAnswer, match=r"1 s; the settings are as they were$"):
        mount.apply({"x": {"pulse_us": 1000, "run_duty": 9}})
    assert mount.settings() == before


def test_a_board_that_is_lost_in_the_middle_of_a_change_leaves_it_unknown_and_that_is_told(monkeypatch):
    mount = Mount.open("virtual://?speed=max")
    at_the_run_duty(mount, monkeypatch, mount.close)
    with pytest.raises(errors.ConnectionLost, match="which settings are changed is not known"):
        mount.apply({"x": {"pulse_us": 1000, "run_duty": 9}})


def test_an_encoder_that_is_told_as_lost_meanwhile_keeps_nothing_from_being_put_back(mount, monkeypatch):
    def refused():
        send = mount.session.send

        def told(_line):
            monkeypatch.setattr(mount.session, "send", send)
            raise errors.BoardError(249, "X ENCODER LOST")

        monkeypatch.setattr(mount.session, "send", told)
        raise errors.BoardError(135, "NOT NOW")

    before = mount.settings()
    at_the_run_duty(mount, monkeypatch, refused)
    with pytest.raises(errors.SettingRefused, match=r"135.*; the settings are as they were$"):
        mount.apply({"x": {"pulse_us": 1000, "run_duty": 9}})
    assert mount.settings() == before


def test_what_the_board_does_not_take_back_is_named_and_all_else_is_put_back(mount, monkeypatch):
    def refused(session, axis, name, value):
        if name == "take_up_us" or value == 200_000:
            raise errors.SettingRefused(f"{axis}.{name} = {value}: no")
        return set_(session, axis, name, value)

    set_ = settings._set
    monkeypatch.setattr(settings, "_set", refused)
    with pytest.raises(errors.SettingRefused, match=r"y\.take_up_us = 5: no; .* not take back x\.pulse_us = 200000$"):
        mount.apply({"x": {"pulse_us": 1000, "step_duty": 9}, "y": {"take_up_us": 5}})
    assert mount.settings()["x"]["step_duty"] == 255
