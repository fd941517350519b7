"""What a board file may say, and how deploy finds one."""

from pathlib import Path

import pytest
from deployed import contents

import mountfw
from mirrormount import errors
from mirrormount.deploy.firmware import read_pins
from mirrormount.deploy.micropython import deploy
from mirrormount.deploy.prompt import Options

BOARDS = Path(mountfw.__file__).parent / "boards"


def test_a_board_is_chosen_by_name_and_stays_chosen(deployed):
    assert deployed.deploy("--board", "pico_drv8833").returncode == 0
    assert deployed.deploy().returncode == 0
    assert contents(deployed.root)["mountfw/boards/this.py"] == b"from mountfw.boards.pico_drv8833 import *\n"


def test_ones_own_pins_are_what_the_board_runs_with(deployed, tmp_path):
    pins = tmp_path / "pins.py"
    pins.write_text((BOARDS / "pico.py").read_text().replace('b"Raspberry Pi Pico"', 'b"My Pico"'))
    done = deployed.deploy("--pins", str(pins))
    assert "OK: My Pico, " in done.stdout, done.stderr


FROM_PICO = "from mountfw.boards.pico import *\n"
AXIS_1 = {"en": 2, "pos": 3, "neg": 4, "stop_pos": 10, "stop_neg": 11}
PINS_THAT_CANNOT_WORK = [
    (FROM_PICO + "BRIDGE = 'Enable'", "BRIDGE is 'enable' or 'two-pwm', not 'Enable'"),
    (FROM_PICO + "EMERGENCY_STOPP = 14", "EMERGENCY_STOPP is no name of a board file"),
    (FROM_PICO + "EMERGENCY_STOP = 10", "pin 10 is used twice: EMERGENCY_STOP and AXIS_1"),
    (FROM_PICO + "LED = 'GP7'", "pin 7 is used twice: LED and AXIS_2 neg"),
    (FROM_PICO + "LED = 99", "LED is the number of a GPIO"),
    (FROM_PICO + "PWM_HZ = 4e3", "PWM_HZ is a whole number"),
    (FROM_PICO + "BRIDGE = 'two-pwm'", '"en" is a pin for BRIDGE "enable", and None'),
    (FROM_PICO + "AXIS_1 = {'pos': 3}", "AXIS_1 says en, pos, neg, stop_pos, stop_neg"),
    (FROM_PICO + "NAME = b'a,b'", "NAME is"),
    (FROM_PICO + "AXIS_1 = {'en': 21, 'pos': 3, 'neg': 4, 'stop_pos': None, 'stop_neg': None}", "share one PWM output"),
    (
        FROM_PICO + "AXIS_4 = {'en': 16, 'pos': 17, 'neg': 18, 'stop_pos': None, 'stop_neg': None}",
        "AXIS_4 is there, but AXIS_3 is missing: axes are numbered without a gap",
    ),
    (
        FROM_PICO + "AXIS_3 = {'en': 16, 'pos': 17, 'neg': 4, 'stop_pos': None, 'stop_neg': None}",
        "pin 4 is used twice: AXIS_1 neg and AXIS_3 neg",
    ),
    (
        FROM_PICO + f"AXIS_1 = {AXIS_1 | {'encoder': (10, 11)}}",
        "pin 10 is used twice: AXIS_1 stop_pos and AXIS_1 encoder",
    ),
    (FROM_PICO + f"AXIS_1 = {AXIS_1 | {'encoder': 8}}", '"encoder" is a pair of GPIO numbers: A and B'),
    (FROM_PICO + f"AXIS_1 = {AXIS_1 | {'shaft': (8,)}}", '"shaft" is a pair of GPIO numbers: SDA and SCL'),
    (FROM_PICO + f"AXIS_1 = {AXIS_1 | {'encoder': (8, 9), 'shaft': (20, 21)}}", "AXIS_1"),
    (FROM_PICO + f"AXIS_1 = {AXIS_1 | {'encoders': (8, 9)}}", "AXIS_1 says .* encoder or shaft where one is fitted"),
    (FROM_PICO + "AXIS_3 = {'en': 16}", "AXIS_3 says en, pos, neg, stop_pos, stop_neg"),
    ("from mountfw.boards.picco import *", "there is no board file 'picco'"),
    ("import os\nos.abort()", "constants only"),
    ("NAME = open('x').read()", "pins.py:1: a board file holds constants only"),
    ("X = " + "[" * 5000, "pins.py"),
    ("X = " + "9" * 5000, "pins.py"),
    (FROM_PICO + "BRIDGE = 0x" + "F" * 5000, "constants only"),
    (FROM_PICO + "#" * (1 << 16), "no board file"),
    # in UTF-7 line 2 opens a string and line 4 closes it; a board takes every file as UTF-8 and would run line 3
    ("# coding: utf-7\n#+AAoAIgAiACI-\nimport machine\n#+ACIAIgAi-\n" + FROM_PICO, "pins.py:3: .* constants only"),
]


@pytest.mark.parametrize(
    ("text", "says"),
    [("NAME = (", "pins.py:1"), ("NAME = b'x'", "also says AXIS_1"), (None, "No such file"), *PINS_THAT_CANNOT_WORK],
)
def test_pins_that_cannot_work_are_refused_before_a_board_is_looked_for(tmp_path, text, says):
    pins = tmp_path / "pins.py"
    if text:
        pins.write_text(text)
    with pytest.raises(errors.DeployError, match=says):
        deploy(Options(port="/nowhere", pins=pins))


@pytest.mark.parametrize("name", ["GATE", "LANE", "ONE_CHANNEL"])
def test_what_a_board_file_may_switch_off_is_a_truth_value(tmp_path, name):
    pins = tmp_path / "pins.py"
    pins.write_text(FROM_PICO + f"{name} = False\n")
    assert read_pins(pins) == pins.read_bytes()
    pins.write_text(FROM_PICO + f"{name} = 0\n")
    with pytest.raises(errors.DeployError, match=f"{name} is True or False"):
        read_pins(pins)


@pytest.mark.parametrize("fitted", [{"encoder": (8, 9)}, {"shaft": (8, 9)}])
def test_pins_of_an_encoder_are_taken(tmp_path, fitted):
    pins = tmp_path / "pins.py"
    pins.write_text(FROM_PICO + f"AXIS_1 = {AXIS_1 | fitted}\n")
    assert read_pins(pins) == pins.read_bytes()


def test_an_unknown_board_changes_nothing_and_names_those_there_are(deployed):
    before = contents(deployed.root)
    done = deployed.deploy("--board", "picco")
    names = "adafruit_feather_esp32s3, adafruit_feather_rp2040, pico, pico2, pico2_w, pico_drv8833, pico_w, rp2, seeed_"
    assert f"only {names}" in done.stderr
    assert contents(deployed.root) == before
