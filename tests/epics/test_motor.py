"""What each field of a motor does, without EPICS: beside traces of the real motor record, and for what goes wrong."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from motor_player import Player

from mirrormount.errors import MountError
from mirrormount_epics.motor import COMM, GO, INVALID, MAJOR, MOVE, PAUSE, STATE, STOP, TARGETS, Setup
from mountfw import codes as wire

TRACES = json.loads(Path(__file__).with_name("traces.json").read_text())

# ---- the real motor record


def rest(p: Player) -> None:
    for field, value in (("SET", 0), ("SPMG", GO), ("JOGF", 0)):
        p.put(field, value)
    if p.drive.jogs:
        p.halted(p.drive.position)
        p.drive.jogs = False
    for field, value in (("OFF", 0.0), ("DIR", 0)):
        p.put(field, value)
    p.go("VAL", 0.0)
    p.order()


def jogged(p: Player, position: float, field: str, value: float) -> None:
    p.put("JOGF", 1)
    p.reach(position - 1)
    p.put(field, value)


def jog_and_stop(p: Player, position: float, field: str, value: float) -> None:
    jogged(p, position, field, value)
    p.halted(position)
    p.drive.jogs = False


def in_mid_move(p: Player, first: float, field: str, value: float) -> None:
    p.put("VAL", first)
    p.reach(1.0)
    p.put(field, value)


def retarget(p: Player, first: float, second: float) -> None:
    in_mid_move(p, first, "VAL", second)
    p.superseded(2.0)
    p.finish()


def stopped(p: Player, field: str, value: int) -> None:
    in_mid_move(p, 8.0, field, value)
    p.halted(2.0)


def paused(p: Player) -> None:
    in_mid_move(p, 4.0, "SPMG", PAUSE)
    p.halted(2.0)
    p.put("SPMG", GO)
    p.finish()


def defined(p: Player, frozen: int, position: float) -> None:
    for field, value in (("FOFF", frozen), ("SET", 1)):
        p.put(field, value)
    p.go("VAL", position)
    p.put("SET", 0)


def limits(p: Player, low: float, high: float) -> None:
    p.put("DLLM", low)
    p.put("DHLM", high)


def tweaked_beyond(p: Player) -> None:
    p.put("TWV", 1.0)
    p.go("VAL", 5.0)
    p.put("TWF", 1)


def from_coordinates(p: Player) -> None:
    """As it was left for this trace: the offset was put to 0 with the direction reversed, and then that reversed."""
    for field, value in (("OFF", 0.0), ("DIR", 0)):
        p.put(field, value)
    p.go("VAL", 0.0)
    p.order()


Play = Callable[[Player], object]
PLAYS: dict[str, tuple[Play, ...]] = {  # the last one is the stimulus
    "val callback": (lambda p: p.go("VAL", 2.0),),
    "same value": (lambda p: p.go("VAL", 2.0),),
    "dval": (lambda p: p.go("DVAL", 1.0),),
    "rval": (lambda p: p.go("RVAL", 3),),
    "rlv": (lambda p: p.go("RLV", -1.0),),
    "twf": (lambda p: p.go("TWF", 1),),
    "twr": (lambda p: p.go("TWR", 1),),
    "fraction 1.3": (lambda p: p.go("VAL", 1.3),),
    "fraction again 1.3": (lambda p: p.go("VAL", 1.3),),
    "stop": (rest, lambda p: stopped(p, "STOP", 1)),
    "stop at rest": (rest, lambda p: p.put("STOP", 1)),
    "opposite in mid-move": (lambda p: retarget(p, 8.0, -2.0),),
    "same way in mid-move": (rest, lambda p: retarget(p, 3.0, 6.0)),
    "spmg stop in mid-move": (rest, lambda p: stopped(p, "SPMG", STOP)),
    "val while stopped": (lambda p: p.put("VAL", 4.0),),
    "go": (lambda p: p.put("SPMG", GO),),
    "pause and go": (rest, paused),
    "move mode": (rest, lambda p: (p.put("SPMG", MOVE), p.go("VAL", 2.0))),
    "beyond": (rest, lambda p: limits(p, -5.0, 5.0), lambda p: p.put("VAL", 9.0)),
    "within again": (lambda p: p.go("VAL", 1.0),),
    "twf beyond": (tweaked_beyond,),
    "set variable": (lambda p: limits(p, -1e6, 1e6), rest, lambda p: defined(p, 0, 10.0)),
    "set frozen": (lambda p: p.put("OFF", 0.0), rest, lambda p: defined(p, 1, 2.0)),
    "back to 0": (lambda p: p.put("FOFF", 0), lambda p: p.go("VAL", 0.0)),
    "off": (lambda p: p.put("OFF", 3.0),),
    "dir": (lambda p: p.put("DIR", 1),),
    "val with dir": (lambda p: p.go("VAL", 1.0),),
    "jog and 0": (from_coordinates, lambda p: jog_and_stop(p, 6.0, "JOGF", 0)),
    "jog and stop": (rest, lambda p: jog_and_stop(p, 2.0, "STOP", 1)),
    "val in a jog": (rest, lambda p: (jogged(p, 2.0, "VAL", 0.0), p.superseded(2.0), p.finish())),
    "sync": (rest, lambda p: p.put("SYNC", 1)),
    "two clients put with callback": (rest, lambda p: (p.go("VAL", 4.0), p.go("VAL", 1.0))),
}
REFUSED = "the put fails with an alarm, where the motor record lets it succeed or hang"
OTHERWISE = {  # and why
    "val while stopped": REFUSED,
    "go": "nothing waits, because the put before it was refused",
    "beyond": REFUSED,
    "twf beyond": REFUSED,
    "val in a jog": "the target is gone to; the motor record forgets it, and leaves .JOGF at 1",
    "sync": "without the .JOGF that the motor record has left at 1",
    "two clients put with callback": "the same",
}


@pytest.fixture(scope="module")
def seen() -> dict[str, tuple[str, dict]]:
    """All plays one after the other, as the traces were recorded."""
    player, seen = Player(), {}
    for name, (*before, stimulus) in PLAYS.items():
        for prepare in before:
            prepare(player)
        player.order()
        stimulus(player)
        end = {field: _rounded(player.record[field]) for field in TRACES["usual"]}
        seen[name] = player.order(), {f: value for f, value in end.items() if value != TRACES["usual"][f]}
    return seen


def _rounded(value):
    return round(value, 3) if isinstance(value, float) else value


def test_every_trace_is_played():
    assert list(PLAYS) == list(TRACES["traces"]) and set(OTHERWISE) < set(PLAYS)


@pytest.mark.parametrize("name", [name for name in PLAYS if name not in OTHERWISE])
def test_clients_see_what_the_real_motor_record_shows(seen, name):
    trace = TRACES["traces"][name]
    assert seen[name] == (trace["order"], trace["end"])


@pytest.mark.parametrize("name", OTHERWISE)
def test_only_what_is_listed_is_otherwise(seen, name):
    trace = TRACES["traces"][name]
    assert seen[name] != (trace["order"], trace["end"])


# ---- what goes wrong


@pytest.fixture
def p() -> Player:
    player = Player()
    player.order()
    return player


def refused(p: Player, why: str) -> bool:
    """Refused for that reason, with an alarm, and nothing was asked of the axis."""
    record = p.record
    return why in record["ESTP"] and (record["STAT"], record["SEVR"], record["DMOV"]) == (STATE, MAJOR, 1)


@pytest.mark.parametrize("field", ["VAL", "DVAL", "RLV", "OFF", "HLM", "LLM", "DHLM", "DLLM", "VELO"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_what_is_no_number_is_refused_and_all_is_as_it_was(p, field, value):
    before = dict(p.record.values)
    assert not p.put(field, value)
    assert refused(p, "finite")
    changed = {name for name, now in p.record.values.items() if now != before[name]}
    assert changed == {"ESTP", "SEVR", "STAT"} and p.drive.orders == []


@pytest.mark.parametrize(("field", "value"), [("VAL", 1e300), ("VAL", 1000000.5), ("DVAL", -2e6), ("RVAL", 2**31 - 1)])
def test_a_target_beyond_the_limits_fails_and_does_not_look_done(p, field, value):
    assert not p.put(field, value)
    assert refused(p, "limits") and p.record["LVIO"] == 1 and p.drive.orders == []
    assert p.order() == "DMOV=0 LVIO=1 DMOV=1"


def test_a_refusal_in_mid_move_leaves_the_move_alone(p):
    p.put("VAL", 5.0)
    assert not p.put("VAL", 1e9)
    assert p.record["VAL"] == 5.0 and p.record["DMOV"] == 0 and len(p.drive.orders) == 1
    p.finish()
    assert (p.record["DMOV"], p.record["SEVR"]) == (1, 0)


@pytest.mark.parametrize("field", TARGETS)
def test_done_moving_is_0_before_a_put_returns(p, field):
    p.put("TWV", 3.0)
    p.order()
    p.put(field, 1)
    assert p.record["DMOV"] == 0 and p.record.dones == 0
    p.finish()
    assert p.order() == "DMOV=0 MOVN=1 MOVN=0 DMOV=1" and p.record.dones == 1


def test_the_position_is_told_before_done_moving(p):
    p.put("VAL", 2.0)
    p.told.clear()
    p.finish()
    assert p.told.index("RBV=2.0") < p.told.index("DMOV=1")


@pytest.mark.parametrize("field", ["STOP", "JOGF", "JOGR", "HOMF", "HOMR", "TWF", "TWR"])
def test_a_button_works_by_a_1_and_not_by_a_0(p, field):
    p.put(field, 0)
    assert p.drive.orders == [] and p.record["DMOV"] == 1


def test_a_stop_by_somebody_else_is_a_failure_and_latches_stop(p):
    p.put("VAL", 9.0)
    p.reach(1.0)
    p.drive.in_control = False
    p.motor.lost()
    p.halted(2.0, wire.ABORTED)
    record = p.record
    assert (record["SPMG"], record["SEVR"], record["VAL"], record["DMOV"]) == (STOP, MAJOR, 2.0, 1)
    orders = len(p.drive.orders)
    for field in (*TARGETS, "JOGF", "JOGR", "HOMF", "HOMR"):
        assert not p.put(field, 1)
    assert len(p.drive.orders) == orders
    assert p.put("SPMG", GO) and p.drive.orders[-1] == ("take control",)
    assert p.go("VAL", 3.0) and p.record["SEVR"] == 0


def test_without_control_nothing_is_asked_even_if_nobody_has_told_that_it_is_lost(p):
    p.drive.in_control = False
    assert not p.put("VAL", 3.0)
    assert refused(p, "Go") and p.drive.orders == []


def test_a_stop_goes_out_although_somebody_else_has_control(p):
    p.drive.in_control = False
    p.put("STOP", 1)
    assert p.drive.orders == [("halt",)]


def test_an_own_stop_is_no_failure(p):
    p.put("VAL", 9.0)
    p.reach(1.0)
    p.put("STOP", 1)
    p.halted(2.0)
    assert (p.record["VAL"], p.record["SEVR"], p.record["DMOV"], p.record.dones) == (2.0, 0, 1, 1)


@pytest.mark.parametrize("reason", [wire.END_STOP, wire.SOFT_LIMIT, wire.STALLED, wire.KEEP_ALIVE, wire.FAULT])
def test_a_move_that_ends_early_is_noticed(p, reason):
    p.put("VAL", 9.0)
    p.reach(1.0)
    p.halted(2.0, reason)
    record = p.record
    assert (record["SEVR"], record["VAL"], record["DMOV"], record["WHY"]) == (MAJOR, 2.0, 1, reason)
    assert wire.REASONS[reason] in record["ESTP"]


def test_a_put_while_paused_waits_for_go(p):
    p.put("SPMG", PAUSE)
    assert p.put("VAL", 3.0) and p.put("VAL", 4.0)
    assert p.drive.token == 0 and p.record["DMOV"] == 0
    p.put("SPMG", GO)
    assert p.drive.orders[-1] == ("move_to", 4) and p.drive.token == 1
    p.finish()
    assert (p.record["DMOV"], p.record["RBV"]) == (1, 4.0)


def test_a_stop_drops_what_waits_in_a_pause(p):
    p.put("SPMG", PAUSE)
    p.put("VAL", 3.0)
    p.put("STOP", 1)
    assert (p.record["DMOV"], p.record["VAL"]) == (1, 0.0)
    p.put("SPMG", GO)
    assert ("move_to", 3) not in p.drive.orders


def test_a_stop_by_somebody_else_drops_what_waits_in_a_pause(p):
    p.put("SPMG", PAUSE)
    p.put("VAL", 3.0)
    p.drive.in_control = False
    p.motor.lost()
    p.put("SPMG", GO)
    assert p.drive.orders[-1] == ("take control",) and p.drive.token == 0 and p.record["DMOV"] == 1


def test_a_motion_by_somebody_else_is_not_done_and_its_end_is_the_target(p):
    p.reach(1.0)
    assert p.record["DMOV"] == 0
    p.drive.token = -1
    p.halted(2.0, wire.DONE)
    assert (p.record["DMOV"], p.record["VAL"], p.record["RBV"]) == (1, 2.0, 2.0)


def test_without_its_board_a_motor_has_an_alarm_and_takes_nothing(p):
    p.put("VAL", 9.0)
    p.reach(1.0)
    p.drive.connected = p.drive.in_control = False
    p.motor.lost()
    p.motor.ended(p.drive.token, 0, "the board has gone")
    record = p.record
    assert (record["STAT"], record["SEVR"], record["DMOV"], record["SPMG"]) == (COMM, INVALID, 1, STOP)
    assert not p.put("VAL", 3.0) and not p.put("SPMG", GO)
    p.drive.connected = True
    p.motor.connected()
    assert p.record["SPMG"] == STOP


def test_after_a_restart_of_the_board_the_target_is_where_it_stands(p):
    p.go("VAL", 7.0)
    p.drive.position = 0.0
    p.motor.attach(p.drive, p._axis(False), Setup())
    assert (p.record["VAL"], p.record["RBV"], p.record["DIFF"]) == (0.0, 0.0, 0.0)


def test_after_a_start_in_mid_move_who_waits_for_it_knows_that_it_ended_early(p):
    p.motor.attach(p.drive, p._axis(False, wire.ABORTED), Setup())
    assert p.record["SEVR"] == MAJOR and "aborted" in p.record["ESTP"]


@pytest.mark.parametrize(("field", "value"), [("HLM", -2e6), ("LLM", 2e6), ("DHLM", -1e6)])
def test_limits_that_leave_nothing_are_refused(p, field, value):
    assert not p.put(field, value)
    assert refused(p, "not below") and p.drive.orders == []


def test_a_limit_between_two_steps_is_the_step_within(p):
    p.put("HLM", 5.5)
    p.put("LLM", -5.5)
    assert p.drive.orders == [("limit", -1_000_000, 5), ("limit", -5, 5)]


def test_a_velocity_that_its_pulses_do_not_allow_is_refused(p):
    assert p.record["VMAX"] == 4.0
    assert not p.put("VELO", 5.0) and not p.put("VELO", 0.0) and not p.put("VELO", -1.0)
    assert p.put("VELO", 3.0) and p.drive.orders == [("velocity", 3.0)]


def test_with_a_scale_all_is_in_its_unit(p):
    p.motor.configure(Setup("mrad", 0.5, 2.0, 4.0, 0.1, -10, 10))
    record = p.record
    assert (record["EGU"], record["VELO"], record["HLM"], record["LLM"], record["ACCL"]) == (
        "mrad",
        1.0,
        5.0,
        -5.0,
        0.1,
    )
    p.go("VAL", 1.3)
    assert p.drive.orders == [("move_to", 3)]
    assert (record["VAL"], record["RBV"], record["RRBV"], record["RDBD"]) == (1.3, 1.5, 3, 0.25)


def test_what_the_drive_refuses_fails_the_put(p, monkeypatch):
    def no(_steps):
        raise MountError("a page has control")

    monkeypatch.setattr(p.drive, "move_to", no)
    assert not p.put("VAL", 3.0)
    assert refused(p, "a page has control") and p.record["VAL"] == 0.0
