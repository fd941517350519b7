"""Homing and its neighbours as they are spoken on the wire, word for word."""

import pytest
from transcript import AT_REST, NO_ERROR, opened, sent, started

from mirrormount import errors
from mirrormount.device.status import Homed

MOVING = "7,200,0|0,0,0,0,1,1|5000,1,-1,0,0,1"


@pytest.mark.parametrize(("answer", "discrepancy"), [("1,-250", -0.25), ("1,0", 0.0), ("0,0", None)])
def test_homing_tells_by_how_much_the_count_was_off(answer, discrepancy):
    mount = opened(
        [
            *sent("2XT?;2XP?", "120000; 200000"),
            *started("2OR"),
            ("XS?", MOVING),
            ("XS?", MOVING),
            ("XS?", AT_REST),
            ("2XE?", "1,-40,8000000"),
            *sent("2OR?", answer),
        ]
    )
    assert mount.x.home() == Homed(discrepancy)
    mount.close()


@pytest.mark.parametrize(
    ("code", "says"), [(145, "SWITCH NOT FOUND"), (146, "SWITCH NOT RELEASED"), (104, "POSITIVE END-STOP REACHED")]
)
def test_homing_that_fails_says_why_and_gives_no_home(code, says):
    mount = opened(
        [
            *sent("1XT?;1XP?", "120000; 200000"),
            *started("1OR"),
            ("XS?", AT_REST),
            ("1XE?", "12,-40,8000000"),
            ("TB?", f"{code}, AXIS 1 {says}"),
            ("TB?", NO_ERROR),
        ]
    )
    with pytest.raises(errors.MoveEnded, match=f"homing failed.*{says.lower()}") as ended:
        mount.y.home()
    assert ended.value.reason == 12
    mount.close()


def test_homing_without_a_switch_is_refused_by_the_board():
    refusal = "235, AXIS 2 NOT FITTED OR SWITCHED OFF"
    asked = sent("2XT?;2XP?", "120000; 200000")
    mount = opened([*asked, *sent("XK500;2OR", error=refusal), ("TB?", NO_ERROR)])
    with pytest.raises(errors.BoardError, match="235"):
        mount.x.home()
    mount.close()


@pytest.mark.parametrize(("direction", "command"), [(1, "2MT+"), (-1, "2MT-")])
def test_an_end_stop_is_found_in_its_direction(direction, command):
    asked = sent("2XT?;2XP?", "120000; 200000")
    mount = opened([*asked, *started(command), ("XS?", AT_REST), ("2XE?", "1,64,9000000")])
    mount.x.find_end_stop(direction)
    mount.close()


@pytest.mark.parametrize("direction", [0, 2, "+", True, None, 1.5])
def test_an_end_stops_direction_that_is_none_is_refused_before_anything_is_sent(direction):
    mount = opened([])
    with pytest.raises(errors.BadValue):
        mount.x.find_end_stop(direction)
    mount.close()


def test_homing_that_takes_longer_than_the_board_allows_is_stopped():
    stop = [("!", None), ("!", None), ("XS?", AT_REST)]
    mount = opened([*sent("2XT?;2XP?", "1000; 200000"), *started("2OR"), ("XS? …", MOVING), *stop])
    before_s = mount.link.monotonic()
    with pytest.raises(errors.NoAnswer, match="still moving"):
        mount.x.home()
    assert mount.link.monotonic() - before_s > 2  # XT, and as much for the rests
    mount.close()


def test_save_is_one_command_and_its_refusal_is_told():
    refused = sent("SM", error="214, AXIS 2 MOTION IN PROGRESS")
    mount = opened([*sent("SM"), *refused, ("TB?", NO_ERROR)])
    mount.save()
    with pytest.raises(errors.BoardError) as refusal:
        mount.save()
    assert refusal.value.code == 214
    mount.close()


def test_an_answer_that_is_none_is_no_traceback():
    mount = opened([*sent("2OR?", "1,x"), *sent("2SL?;2SR?;2ZH?", "1; 2")])
    with pytest.raises(errors.NotAMount):
        mount.x.ask_whole("OR?")
    with pytest.raises(errors.NotAMount):
        _ = mount.x.limits
    mount.close()
