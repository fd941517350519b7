"""What cannot be a command line: told by the command that it is of, with exit status 2, before a port is opened."""

import argparse
from collections.abc import Iterator

import pytest

from mirrormount.cli import main

PORT = ("--port", "/dev/does-not-exist")


def parsers(of: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The parser, and those of all commands, verbs and sources below it."""
    yield of
    for action in of._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from parsers(below)


def refused(capsys, *words: str) -> str:
    """What is said of a command line that is none."""
    with pytest.raises(SystemExit) as ended:
        main.main([*words])
    assert ended.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    return err


def test_no_command_takes_a_part_of_an_option_for_the_option():
    every = list(parsers(main.parser()))
    assert len(every) > 40
    assert [each.prog for each in every if each.allow_abbrev] == []


@pytest.mark.parametrize(
    ("words", "full"),
    [
        (("check", "--mov", *PORT), "--move"),
        (("config", "set", "--sav", "x.pulse_us", "150000", *PORT), "--save"),
        (("config", "restore", "--fact", *PORT), "--factory"),
        (("deploy", "--repl", *PORT), "--replace-main"),
        (("jog", "x", "0.5", "--sec=3", *PORT), "--seconds"),
        (("undeploy", "--dri", "x"), "--drive"),
    ],
)
def test_a_part_of_an_option_does_nothing_and_the_option_is_named(words, full, capsys):
    said = refused(capsys, *words)
    assert "unrecognized arguments: --" in said and f"(an option is written in full: {full})" in said


@pytest.mark.parametrize(
    ("words", "command"),
    [
        (("ports", "x"), "ports"),
        (("home", "x", "y"), "home"),
        (("config", "get", "a", "b"), "config get"),
        (("table", "remove", "a", "b"), "table remove"),
        (("camera", "scale", "show", "b"), "camera scale show"),
        (("check", "--fast"), "check"),
    ],
)
def test_a_word_too_many_is_told_with_the_usage_of_its_command(words, command, capsys):
    said = refused(capsys, *words)
    assert said.startswith(f"usage: mirrormount {command} [-h]")
    assert said.splitlines()[-1] == f"mirrormount {command}: error: unrecognized arguments: {words[-1]}"


@pytest.mark.parametrize("option", ["--port", "--port=virtual://", "--virtual"])
def test_an_option_before_its_command_is_told_where_it_stands(option, capsys):
    said = refused(capsys, option, "virtual://", "status").splitlines()[-1]
    name = option.partition("=")[0]
    assert said == f"mirrormount: error: {name} stands behind the command: mirrormount COMMAND {name}"


def test_the_file_of_names_may_still_stand_before_the_command(capsys):
    assert "required: AXIS" in refused(capsys, "--table", "table.toml", "home", *PORT)


def test_no_command_at_all_prints_the_list_of_commands(capsys):
    assert main.main([]) == 2
    out, err = capsys.readouterr()
    assert out == "" and all(f"\n    {name} " in err for name in main.MODULES)


@pytest.mark.parametrize("words", [("step", "z", "1"), ("step", "x"), ("step", "x", "1", "ells"), ("walk", "x")])
def test_what_is_no_form_of_a_command_is_wrong_usage(words, capsys):
    assert refused(capsys, *words).startswith("usage: mirrormount ")


@pytest.mark.parametrize("words", [("step", "x", "far"), ("config", "set", "x.pulse_us", "3"), ("drive", "256", "0")])
def test_a_value_that_cannot_be_is_an_error_like_any_other(words, capsys):
    assert main.main([*words, "--port", "virtual://?speed=max"]) == 1
    assert capsys.readouterr().err.startswith("mirrormount: ")


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("stpe", "x", "2"), "step"),
        (("statsu",), "status"),
        (("camera", "shwo"), "show"),
        (("move", "x", "1", "beam-mard"), "beam-mrad"),
        (("virtual", "--profile", "ruogh"), "rough"),
        (("jog", "x", "0.5", "--secnds", "3", *PORT), "--seconds"),
    ],
)
def test_a_word_that_is_nearly_right_is_answered_with_the_right_one(words, meant, capsys):
    assert meant in refused(capsys, *words).splitlines()[-1].partition("; did you mean ")[2]


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("step", "x", "1mard"), "mrad"),
        (("status", "--port", "virtual://?profile=ruogh"), "rough"),
        (("status", "--port", "virtual://?bench=swiches"), "switches"),
        (("status", "--port", "virtual://?machin=cpython"), "machine"),
        (("status", "--port", "virtul://"), "virtual"),
        (("status", "--port", "virtual://?fault=m1:brokn"), "broken"),
        (("camera", "show", "--camera", "virtual-table://?camera=1"), "cameras"),
        (("camera", "show", "--camera", "virtal-table://"), "virtual-table"),
        (("camera", "show", "--camera", "neer"), "near"),
        (("camera", "show", "--virtual", "--channel", "gren"), "green or grey"),
        (("camera", "show", "--camera", "0", "--backend", "v4l"), "v4l2"),
        (("table", "remove", "neer"), "near"),
        (("measure", "steps", "--virtual", "--step", "3", "mard"), "mrad"),
        (("align", "--signal", "fibre", "--virtual", "--axes", "secnd.y"), "second.y or second.x"),
        (("log", "--since", "yestrday"), "yesterday"),
    ],
)
def test_a_name_that_is_nearly_right_is_answered_with_the_right_one(words, meant, capsys, own_folder, tmp_path):
    (tmp_path / "table.toml").write_text('[cameras.near]\ncamera = "0"\n')
    assert main.main([*words]) == 1
    assert f"; did you mean {meant}?\n" in capsys.readouterr().err


def test_a_setting_that_is_nearly_right_is_answered_with_the_right_one(capsys):
    assert main.main(["config", "get", "x.velocty", "--port", "virtual://?speed=max"]) == 1
    assert "; did you mean velocity?" in capsys.readouterr().err
