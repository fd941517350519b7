"""Every cell of the axis's table: each event in each state, done on a rig. Runs under CPython and MicroPython."""

from mountfw import codes
from mountfw.motion import axis as a

from rig import Rig  # isort: skip

POSITIVE, NEGATIVE = 10, 11  # inputs of axis 1 on the Pico
ENABLE = 2
EVENTS = (
    ("ASK", 0),
    ("BEGIN", 100),
    ("SEEK", -100),
    ("FRAME", -77),
    ("FINISH", codes.STOPPED),
    ("END", codes.ABORTED),
    ("DUE_TAKE_UP", 5_000),
    ("DUE_PULSE", 5_000),
    ("DUE_RUN", 5_000),
    ("DUE_SEARCH", 5_000),
    ("DUE_SETTLE", 5_000),
    ("OVER", 0),
    ("LAST_OVER", 0),
    ("HIT", codes.END_STOP),
)
STATES = ("IDLE", "SETTLE", "REST", "TAKE_UP", "PULSE", "RUN", "SEARCH")
DUE = ("DUE_TAKE_UP", "DUE_PULSE", "DUE_RUN", "DUE_SEARCH")

# from each of STATES, in that order: the next state; "refused", and the state stays; "." cannot happen
NEXT = {
    "ASK": "IDLE refused refused refused refused refused refused",
    "BEGIN": "REST . . . . . .",
    "SEEK": "SETTLE . . . . . .",
    "FRAME": "REST REST REST REST REST REST REST",
    "FINISH": "IDLE IDLE IDLE IDLE PULSE IDLE IDLE",
    "END": "IDLE IDLE IDLE IDLE IDLE IDLE IDLE",
    "DUE_TAKE_UP": ". . TAKE_UP . . . .",
    "DUE_PULSE": ". . PULSE . . . .",
    "DUE_RUN": ". . RUN . . . .",
    "DUE_SEARCH": ". SEARCH . . . . .",
    "DUE_SETTLE": ". SETTLE . . . . SETTLE",
    "OVER": ". . . REST REST IDLE IDLE",
    "LAST_OVER": ". . . . IDLE . .",
    "HIT": ". SETTLE IDLE IDLE IDLE IDLE SETTLE",
}
# the reason of each move that ends there, from each of STATES; 0: none ends
ENDS = {
    "FRAME": (0,) + (codes.SUPERSEDED,) * 6,
    "FINISH": (0,) + (codes.STOPPED,) * 3 + (0,) + (codes.STOPPED,) * 2,
    "END": (0,) + (codes.ABORTED,) * 6,
    "OVER": (0, 0, 0, 0, 0, codes.RUN_LIMIT, codes.HOMING_FAILED),
    "LAST_OVER": (0, 0, 0, 0, codes.DONE, 0, 0),
    "HIT": (0, 0) + (codes.END_STOP,) * 4 + (0,),
}
# the error of axis 1 that goes with it
ERRORS = {(codes.RUN_LIMIT, "RUN"): 140, (codes.HOMING_FAILED, "SEARCH"): 145, (codes.END_STOP, "TAKE_UP"): 105}
ERRORS.update({(codes.END_STOP, state): 104 for state in ("REST", "PULSE", "RUN")})

# how axis 1 is brought into each state: what is sent before, which switch is open then, and what is sent last
WAYS = {
    "IDLE": (b"1DH0\n", (), b"\n"),
    "SETTLE": (b"1DH0\n", (NEGATIVE,), b"1OR\n"),
    "REST": (b"1XP1000;1DH0\n", (), b"1PR3\n"),
    "TAKE_UP": (b"1XB120000;1DH0;1VA4;1PR1\n", (), b"1PR-2\n"),
    "PULSE": (b"1DH0\n", (), b"1PR3\n"),
    "RUN": (b"1DH0\n", (), b"1MV+\n"),
    "SEARCH": (b"1DH0\n", (), b"1MT+\n"),
}


def brought_into(state):
    """A rig with both end-stops fitted whose axis 1 is in a state."""
    before, is_open, command = WAYS[state]
    rig = Rig()
    rig.port.switches.update({POSITIVE: 0, NEGATIVE: 0})
    rig.ask(b"1XL3\n")
    rig.ask(before)
    rig.run(400_000)
    for pin in is_open:
        rig.port.switches[pin] = 1
    rig.send(command)
    for _ in range(20_000):
        if rig.axis1.state == getattr(a, state):
            break
        rig.port.horizon_us = rig.port.us + 1_000
        rig.step()
    assert rig.axis1.state == getattr(a, state), state
    rig.port.switches[NEGATIVE] = 0
    assert rig.controller.errors.pop() == 0
    return rig


def errors(rig):
    found = []
    while rig.controller.errors.waiting:
        found.append(rig.controller.errors.pop())
    return found


def assert_consistent(rig, where):
    """What the flags may be in each state."""
    axis, drive = rig.axis1, rig.axis1.drive
    assert not axis.counting and not drive.has_begun, where
    if axis.state > a.REST:
        assert drive.measuring and not axis.resting, where
        assert rig.drives()[0] or drive.was_cut, where
    elif axis.state == a.IDLE:
        assert not drive.measuring and rig.drives()[0] == 0, where
    assert axis.moving() == (axis.state != a.IDLE), where


def test_the_table_has_every_event_in_every_state():
    assert sorted(a.TABLE) == list(range(len(EVENTS)))
    assert sorted(getattr(a, name) for name, _ in EVENTS) == sorted(a.TABLE)
    assert [getattr(a, name) for name in STATES] == list(range(len(STATES)))
    assert all(len(row) == len(STATES) for row in a.TABLE.values())
    assert sorted(NEXT) == sorted(name for name, _ in EVENTS)


def walk(check):
    """check(rig, event, value, state, column) for each cell."""
    cells = 0
    for event, value in EVENTS:
        for column in range(len(STATES)):
            check(brought_into(STATES[column]), event, value, STATES[column], column)
            cells += 1
    assert cells == len(a.TABLE) * 7


def test_each_cell_leads_to_its_state_and_ends_a_move_once_with_its_reason_or_cannot_happen():
    def check(rig, event, value, state, column):
        axis, where = rig.axis1, (event, state)
        expected = NEXT[event].split()[column]
        reason = ENDS.get(event, (0,) * 7)[column]
        axis.reason = 99
        axis.has_moved = False
        if expected == ".":
            try:
                axis.handle(getattr(a, event), value)
            except RuntimeError:
                assert axis.state == column and axis.reason == 99 and errors(rig) == [], where
                return
            raise AssertionError(where)
        axis.handle(getattr(a, event), value)
        if expected == "refused":
            assert axis.state == column and errors(rig) == [114] and axis.reason == 99, where
            return
        assert axis.state == getattr(a, expected), where
        assert axis.reason == (reason or 99) and axis.has_moved == (reason != 0), where
        error = ERRORS.get((reason, state))
        assert errors(rig) == ([error] if error else []), where
        if event not in ("FRAME", "SEEK"):  # a frame leaves the drive on, and homing's phase begins after SEEK
            assert (rig.drives()[0] != 0) == (axis.state > a.REST), where
            assert_consistent(rig, where)

    walk(check)


def test_what_a_pulse_leaves_behind_is_told_by_its_cell():
    for event, state, millisteps, left in (
        ("OVER", "PULSE", 1_000, 2),
        ("OVER", "TAKE_UP", 1_000, 2),  # it stands at 1 step already, and the take-up adds none
        ("FINISH", "PULSE", 0, 1),
        ("LAST_OVER", "PULSE", 1_000, 2),
    ):
        rig = brought_into(state)
        rig.axis1.handle(getattr(a, event), codes.STOPPED if event == "FINISH" else 0)
        assert (rig.axis1.position.millisteps, rig.axis1.pulses_left) == (millisteps, left), (event, state)
        assert rig.axis1.position.certainty == codes.COUNTED
    rig = brought_into("TAKE_UP")
    assert rig.axis1.position.take_up(-1) == 120_000 * 255
    rig.axis1.handle(a.OVER, 0)
    assert rig.axis1.position.take_up(-1) == 0
    for event in ("END", "HIT", "FRAME"):  # cut short: a part of a step, by its time
        rig = brought_into("PULSE")
        rig.run(100_000)
        rig.axis1.handle(getattr(a, event), codes.ABORTED)
        assert 490 < rig.axis1.position.millisteps < 520, event
        assert rig.axis1.position.certainty == codes.ESTIMATED
    for event in ("END", "HIT"):  # and its period is kept
        rig = brought_into("PULSE")
        rig.axis1.handle(getattr(a, event), codes.ABORTED)
        assert rig.axis1.resting


def test_each_way_to_drive_asks_the_gate_first():
    def stop_received(rig):
        rig.axis1.drive.inhibited = codes.STOPPED

    def emergency(rig):
        rig.axis1.drive.emergency = True

    def record_stays(rig):
        rig.axis1.drive.on_flash = True
        rig.axis1.drive.drop_record = lambda: None

    def stop_while_the_record_goes(rig):
        def drop():
            rig.axis1.drive.on_flash = False
            rig.controller.stop_all(codes.ABORTED)
            rig.axis1.drive.inhibited = codes.ABORTED

        rig.axis1.drive.on_flash = True
        rig.axis1.drive.drop_record = drop

    def switch(rig):
        rig.port.switches[POSITIVE if rig.axis1.drive.direction > 0 else NEGATIVE] = 1

    def tripped(rig):
        rig.axis1.drive.tripped = True

    for forbid, reason, error in (
        (stop_received, codes.STOPPED, []),
        (emergency, codes.EMERGENCY_STOP, [143]),
        (record_stays, codes.FAULT, []),
        (stop_while_the_record_goes, codes.ABORTED, []),
        (switch, codes.END_STOP, [104]),
        (tripped, codes.END_STOP, [104]),
    ):
        for event in DUE:
            homes = event == "DUE_SEARCH"
            rig = brought_into("SETTLE" if homes else "REST")
            rig.port.edges.clear()
            rig.axis1.reason = 99
            forbid(rig)
            rig.axis1.handle(getattr(a, event), 5_000)
            assert [pin for _, pin, duty in rig.port.edges if duty] == [], (event, reason)
            if homes and reason == codes.END_STOP:  # there it is the switch that is looked for
                assert (rig.axis1.state, rig.axis1.reason) == (a.SETTLE, 99), event
            else:
                assert (rig.axis1.state, rig.axis1.reason) == (a.IDLE, reason), event
                assert errors(rig) == error, (event, reason)


def test_what_an_interrupt_sets_while_a_drive_is_turned_on_ends_it_in_the_same_call():
    for flag, value, reason in (
        ("inhibited", codes.STOPPED, codes.STOPPED),
        ("emergency", True, codes.EMERGENCY_STOP),
        ("tripped", True, codes.END_STOP),
    ):
        for event in DUE:
            homes = event == "DUE_SEARCH"
            rig = brought_into("SETTLE" if homes else "REST")
            drive = rig.axis1.drive
            turned_on = drive.bridge.drive

            def interrupted(duty, turned_on=turned_on, drive=drive, flag=flag, value=value):
                setattr(drive, flag, value)
                return turned_on(duty)

            drive.bridge.drive = interrupted
            rig.axis1.handle(getattr(a, event), 5_000)
            assert rig.drives()[0] == 0, (event, flag)
            assert not drive.measuring, (event, flag)
            if homes and flag == "tripped":
                assert rig.axis1.state == a.SETTLE, event
            else:
                assert (rig.axis1.state, rig.axis1.reason) == (a.IDLE, reason), (event, flag)


def test_both_switches_open_end_any_drive_as_a_fault():
    for state in ("TAKE_UP", "PULSE", "RUN", "SEARCH"):
        rig = brought_into(state)
        rig.port.switches.update({POSITIVE: 1, NEGATIVE: 1})
        rig.step()
        assert (rig.axis1.state, rig.axis1.reason, rig.drives()[0]) == (a.IDLE, codes.FAULT, 0), state
        assert errors(rig) == [142], state


def test_a_cell_that_cannot_happen_is_an_internal_fault_of_the_loop():
    rig = brought_into("RUN")

    class Enough(BaseException):
        pass

    def watchdog(_on):
        raise Enough

    def impossible(_now_us):
        asked.append(1)
        if len(asked) > 100:  # a fault in each pass keeps the loop from the LED
            raise Enough
        return rig.axis1.handle(a.DUE_PULSE, 5_000)

    asked = []
    handled = rig.axis1.service
    rig.axis1.service = impossible
    rig.port.led = watchdog
    rig.port.horizon_us = rig.port.us + 1_000_000
    try:
        rig.app.run()
    except Enough:
        pass
    rig.axis1.service = handled
    assert rig.drives() == (0, 0)
    assert rig.axis1.reason == codes.FAULT
    assert errors(rig)[0] == codes.INTERNAL_FAULT
