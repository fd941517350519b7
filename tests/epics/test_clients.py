"""Published clients of motor records, unchanged, on `mirrormount ioc` with a virtual board: pins and positions."""

import pytest
from iocs import Ioc
from served import run_process

from mirrormount.device.mount import Mount

SCANNED = [-2.0, -1.0, 0.0, 1.0, 2.0]


def pulses(board, pin="m2_en"):
    """Pulses of an enable that are over."""
    return sum(1 for e in board.edges() if e["pin"] == pin and e["duty"] == 0)


def test_pyepics_moves_in_all_its_ways(ioc, board):
    ioc.run("""
        import epics
        m = epics.Motor(P + "m1:x")
        def moved(to, *how, **named):
            assert m.move(*how, wait=True, timeout=30, **named) == 0
            # Monitors may come after the answer to a put: a server sends them from a thread of their own.
            wait_for(lambda: (m.get("RBV"), m.get("DMOV"), m.get("MOVN")) == (to, 1, 0), f"rest at {to}")
        moved(3, 3)
        moved(2, -1, relative=True)
        moved(1, 1, dial=True)
        moved(2, 2, raw=True)
        moved(2, 2)  # where it is
        m.put("tweak_val", 2, wait=True)
        m.tweak(direction="forward", wait=True, timeout=30)
        assert m.get("RBV") == 4
        m.tweak(direction="reverse", wait=True, timeout=30)
        assert m.get("RBV") == 2
    """)
    assert pulses(board) == 3 + 1 + 1 + 1 + 2 + 2
    assert pulses(board, "m1_en") == 0


def test_pyepics_defines_positions_and_limits(ioc, board):
    ioc.run("""
        import epics
        m = epics.Motor(P + "m1:x")
        m.set_position(10)
        wait_for(lambda: (m.get("OFF"), m.get("RBV"), m.get("VAL")) == (10, 10, 10), "the offset")
        m.put("OFF", 0, wait=True)
        m.put("HLM", 5, wait=True); m.put("LLM", -5, wait=True)
        wait_for(lambda: (m.get("HLM"), m.get("LLM")) == (5, -5), "the limits")
        assert not m.within_limits(6) and m.within_limits(4)
        assert m.move(9, wait=True, timeout=5) != 0
        assert m.move(9, wait=True, timeout=5, ignore_limits=True) != 0
        assert (m.get("LVIO"), m.get("RBV"), epics.caget(P + "m1:x.SEVR")) == (1, 0, 2)
        for bad in (float("nan"), float("inf"), -1e300):
            assert m.move(bad, wait=True, timeout=5, ignore_limits=True) != 0
        assert m.move(1, wait=True, timeout=30) == 0 and epics.caget(P + "m1:x.SEVR") == 0
        m.put("FOFF", 1, wait=True)
        m.set_position(7)
        assert (m.get("OFF"), m.get("RBV"), m.get("DRBV")) == (0, 7, 7)
        print("x", m.get("VELO"))
    """)
    assert pulses(board) == 1


def test_pyepics_jogs_stops_and_takes_a_new_target(ioc, board, rests):
    ioc.run("""
        import epics
        m = epics.Motor(P + "m1:x")
        def moving():
            return m.get("MOVN") == 1
        m.put("JOGF", 1); wait_for(moving, "the jog")
        m.put("JOGF", 0); wait_for(lambda: m.get("DMOV") == 1, "its end")
        assert m.get("VAL") == m.get("RBV") > 0 and epics.caget(P + "m1:x.SEVR") == 0
        assert m.move(0, wait=True, timeout=30) == 0
        m.move(20); wait_for(moving, "the move")
        m.stop(); wait_for(lambda: m.get("DMOV") == 1, "its end")
        assert m.get("VAL") == m.get("RBV") < 20 and epics.caget(P + "m1:x.SEVR") == 0
        m.move(20); wait_for(moving, "the move")
        m.move(0); wait_for(lambda: m.get("DMOV") == 1, "the new target")
        assert m.get("VAL") == 0 and abs(m.get("RBV")) <= 0.5
        assert m.put("HOMF", 1, wait=True, timeout=30) == 1  # there is no switch
        assert epics.caget(P + "m1:x.SEVR") == 2 and m.get("DMOV") == 1
    """)
    rests()


OPHYD = """
import logging
import ophyd
from ophyd import EpicsMotor
x, y = EpicsMotor(P + "m1:x", name="x"), EpicsMotor(P + "m1:y", name="y")
x.wait_for_connection(timeout=30); y.wait_for_connection(timeout=30)
"""


def test_ophyd_moves_and_reads_what_is_true_when_it_is_done(ioc, board):
    ioc.run(
        OPHYD
        + """
for target in (3, 3, -1, 0):
    assert x.move(target, timeout=30).success and x.position == target and not x.moving
status = x.set(30); wait_for(lambda: x.moving, "the move")
x.stop(success=True); status.wait(timeout=30)
assert x.position == x.user_setpoint.get() != 30
x.set_lim(-5, 5); wait_for(lambda: x.limits == (-5, 5), "the limits")
try:
    x.move(9)
except ophyd.utils.LimitError:
    pass
else:
    raise AssertionError("beyond the limits")
try:
    x.home("forward", timeout=30)
except Exception:
    pass
else:
    raise AssertionError("there is no switch")
assert x.move(0, timeout=30).success
"""
    )
    assert not board.driving()


@pytest.mark.full
def test_bluesky_scans_with_ophyd_and_records_where_it_was(ioc):
    *_, rows = ioc.run(
        OPHYD
        + """
from bluesky import RunEngine
import bluesky.plans as bp
RE, rows = RunEngine({}), []
def keep(name, document):
    if name == "event":
        rows.append((document["data"].get("x"), document["data"].get("y")))
RE(bp.scan([], x, -2, 2, 5), keep)
RE(bp.grid_scan([], y, -1, 1, 2, x, -1, 1, 2), keep)
x.move(0); y.move(0)
RE(bp.rel_spiral([], x, y, 3, 3, 1.5, 3), lambda name, document: None)
print(rows)
"""
    )
    grid = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
    assert rows == str([(position, None) for position in SCANNED] + grid)


@pytest.mark.parametrize("protocol", ["ca", "pva"])
def test_ophyd_async_scans_and_records_where_it_was(ioc, protocol):
    rows = ioc.run(
        f"protocol = {protocol!r}"
        + """
from bluesky import RunEngine
import bluesky.plans as bp, bluesky.plan_stubs as bps
from ophyd_async.core import init_devices
from ophyd_async.epics.motor import Motor
RE, rows = RunEngine({}), []
with init_devices():
    x = Motor(f"{protocol}://{P}m1:x")
RE(bps.mv(x, 3)); RE(bps.mv(x, 3))
RE(bp.scan([], x, -2, 2, 5), lambda name, document: name == "event" and rows.append(document["data"]["x"]))
print(rows)
def stopped():
    yield from bps.abs_set(x, -12, group="move")
    yield from bps.sleep(0.7)
    yield from bps.stop(x)
    yield from bps.wait(group="move")
try:
    RE(stopped())
except Exception as e:  # ophyd-async takes a move that was stopped for a failed one
    assert "stopped" in str(e.__cause__ or e) + str(e), e
def read():
    while not (yield from bps.rd(x.motor_done_move)):
        yield from bps.sleep(0.01)
    print((yield from bps.rd(x.motor_done_move)), (yield from bps.rd(x.user_setpoint)) == (yield from bps.rd(x)) > -12)
RE(read())
"""
    )
    assert str(SCANNED) in rows and rows[-1] == "1 True"


def test_a_raw_client_of_pvaccess_puts_and_monitors(ioc, board):
    ioc.run("""
        from p4p.client.thread import Context, RemoteError
        context = Context("pva")
        seen = []
        subscription = context.monitor(P + "m1:x.DMOV", lambda value: seen.append(int(value)))
        wait_for(lambda: seen == [1], "the first value")
        context.put(P + "m1:x.VAL", 2.0, wait=True, timeout=30)
        assert float(context.get(P + "m1:x.RBV")) == 2.0
        wait_for(lambda: seen == [1, 0, 1], f"done, not done, done: {seen}")
        subscription.close()
        def refused(field, value):
            try:
                context.put(P + "m1:x." + field, value, wait=True, timeout=30)
            except RemoteError:
                return True
        assert refused("VAL", 1e9) and refused("RLV", float("nan"))
        context.put(P + "m1:x.HLM", float("nan"), wait=True, timeout=30)  # no order: nothing waits for it
        assert float(context.get(P + "m1:x.HLM")) > 2
        context.put(P + "m1:x.VAL", 1.0, wait=True, timeout=30)  # it is not locked
        assert float(context.get(P + "m1:x.RBV")) == 1.0 and int(context.get(P + "m1:x.SEVR")) == 0
        context.close()
    """)
    assert pulses(board) == 2 + 1


def test_a_move_of_two_clients_at_once_is_two_moves_in_turn(ioc, board):
    """A second put-callback waits for the end of the first (EPICS base), and none is lost."""
    first = ioc.client("""
        import epics
        pv = epics.PV(P + "m1:x.VAL"); pv.wait_for_connection(30)
        event("there")
        assert pv.put(3, wait=True, timeout=60) == 1
    """)
    first.until("there")
    second = ioc.client("""
        import epics
        pv = epics.PV(P + "m1:x.VAL"); pv.wait_for_connection(30)
        event("there")
        assert pv.put(1, wait=True, timeout=60) == 1
    """)
    second.until("there")
    first.go_on()
    second.go_on()
    first.end()
    second.end()
    assert not board.driving()
    assert pulses(board) in (5, 3)  # 3 and 2 back, or 1 and 2 on


def test_what_a_person_has_set_is_there_after_a_restart_and_no_position(ioc, board):
    ioc.run("""
        import epics
        assert epics.caput(P + "m1:x.VAL", 3, wait=True, timeout=30) == 1
        epics.caput(P + "m1:x.OFF", 10, wait=True); epics.caput(P + "m1:x.DESC", "first mirror", wait=True)
    """)
    assert ioc.end() == 0
    with Mount.open(str(board.link)) as mount:
        mount.x.zero(1)
    with Ioc(str(board.link), environment=ioc.environment) as again:
        again.run("""
            import epics
            values = [epics.caget(P + "m1:x." + field) for field in ("OFF", "DESC", "RBV", "VAL")]
            assert values == [10, "first mirror", 11, 11], values
        """)


def test_the_position_has_an_alarm_of_its_own(ioc):
    ioc.run("""
        import epics
        certainty = epics.PV(P + "m1:x:certainty")
        assert certainty.get(as_string=True) == "unknown" and certainty.severity == 1
        assert epics.caget(P + "m1:x.SEVR") == 0
        epics.caput(P + "m1:x.FOFF", 1, wait=True); epics.caput(P + "m1:x.SET", 1, wait=True)
        epics.caput(P + "m1:x.VAL", 0, wait=True, timeout=30); epics.caput(P + "m1:x.SET", 0, wait=True)
        wait_for(lambda: certainty.get(as_string=True) == "counted" and certainty.get_ctrlvars(), "the certainty")
        wait_for(lambda: certainty.severity == 0, "no alarm")
    """)


def test_the_mount_stop_of_epics_stops_both_axes_and_keeps_its_control(ioc, board, drives, rests):
    client = ioc.client("""
        import epics
        epics.caput(P + "m1:x.VAL", 50); epics.caput(P + "m1:y.JOGF", 1)
        wait_for(lambda: epics.caget(P + "m1:y.MOVN") == epics.caget(P + "m1:x.MOVN") == 1, "both motors")
        epics.caput(P + "m1.STOP", 1, wait=True)
        wait_for(lambda: epics.caget(P + "m1:x.DMOV") == epics.caget(P + "m1:y.DMOV") == 1, "the end")
        event("stopped")
        assert epics.caget(P + "m1:x.SEVR") == 0
        assert epics.caput(P + "m1:x.VAL", 0, wait=True, timeout=60) == 1
        assert abs(epics.caget(P + "m1:x.RBV")) <= 0.5
    """)
    client.until("stopped")
    rests()
    client.go_on()
    client.end()


def test_the_command_stop_latches_and_nothing_moves_before_go(ioc, board, drives, rests):
    client = ioc.client("""
        import asyncio
        from aioca import caget, caput, FORMAT_TIME
        axis = P + "m1:x."
        async def refused(field, value=1):
            return not (await caput(axis + field, value, wait=True, timeout=30, throw=False)).ok
        async def main():
            moving = asyncio.create_task(caput(axis + "VAL", 50, wait=True, timeout=None))
            while not await caget(axis + "MOVN"):
                pass
            event("moving")
            await moving
            assert (await caget(axis + "RBV", format=FORMAT_TIME)).severity == 2
            assert (await caget(axis + "SPMG"), await caget(P + "m1:y.SPMG")) == (0, 0)
            for field in ("VAL", "RLV", "TWF", "JOGF", "HOMF"):
                assert await refused(field), field
            event("refused")
            assert not await refused("SPMG", 3)
            event("gone on")
            assert not await refused("VAL", 3)
        asyncio.run(main())
    """)
    client.until("moving")
    drives()
    stop = run_process("stop", "--port", str(board.link))
    assert stop.returncode == 0, stop.stderr
    edges = len(board.edges())
    client.go_on()
    client.until("refused")
    client.go_on()
    client.until("gone on")
    assert len(board.edges()) == edges
    client.go_on()
    client.end()
    assert len(board.edges()) > edges


@pytest.mark.full
def test_a_thousand_monitors_of_one_client_all_get_all_that_is_told(ioc, board):
    """Fifty of each field that a move changes."""
    ioc.run("""
        import epics
        moved = ("RBV", "DRBV", "RRBV", "DMOV", "MOVN", "MIP", "DIFF", "RDIF", "VAL", "DVAL")
        names = [P + axis + field for axis in ("m1:x.", "m1:y.") for field in moved]
        seen, subscriptions = {}, []
        for name in names:
            chid = epics.ca.create_channel(name)
            assert epics.ca.connect_channel(chid, timeout=30)
            for i in range(50):
                told = seen[name, i] = []
                got = lambda value=None, told=told, **_: told.append(value)
                subscriptions.append(epics.ca.create_subscription(chid, callback=got))
        assert len(subscriptions) == 1000
        wait_for(lambda: all(seen.values()), "the first value of each")
        assert epics.caput(P + "m1:x.VAL", 5, wait=True, timeout=50) == 1
        assert epics.caput(P + "m1:y.VAL", -5, wait=True, timeout=50) == 1
        last = {name: epics.caget(name) for name in names}
        wait_for(lambda: all(told[-1] == last[name] for (name, _), told in seen.items()), "the last value of each")
        for name in names:
            assert all(seen[name, i] == seen[name, 0] for i in range(50)), name
        assert seen[P + "m1:x.RBV", 0][-1] == 5 and set(range(6)) <= set(seen[P + "m1:x.RBV", 0])
        assert seen[P + "m1:y.RBV", 0][-1] == -5 and set(range(-5, 1)) <= set(seen[P + "m1:y.RBV", 0])
        print("all", sum(map(len, seen.values())))
    """)
    assert pulses(board) == pulses(board, "m1_en") == 5
