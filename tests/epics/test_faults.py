"""What goes wrong around an IOC: it dies or hangs, its board goes, clients flood it, send rubbish or may not write."""

import contextlib
import random
import signal
import socket
import time
from pathlib import Path

import pytest
from iocs import Ioc
from served import ServedBoard, run_cli

from mirrormount.device.mount import Mount
from mirrormount_epics import fields
from mountfw import codes as wire

KEEP_ALIVE_US = 500_000
TICK_US = 50_000  # the board's pace behind the clock of a busy computer


@pytest.mark.wall_clock  # how late the test is counts against it; the pins are in the board's time
@pytest.mark.parametrize("with_signal", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize(("field", "value"), [("JOGF", 1), ("VAL", 5000)])
def test_an_ioc_that_dies_or_hangs_in_mid_motion_leaves_nothing_running(ioc, board, field, value, with_signal):
    client = ioc.client(f"""
        import epics
        epics.caput(P + "m1:x.{field}", {value})
        epics.caput(P + "m1:y.{field}", {value})
        event("moving")
    """)
    client.until("moving")
    looked_s = time.monotonic()
    while not all(board.enables().values()):
        looked_s = time.monotonic()
    ioc.process.send_signal(with_signal)
    late_us = (time.monotonic() - looked_s) * 1e6
    begun_us = max(edge["t_us"] for edge in board.edges() if edge.get("duty"))
    time.sleep(1.5)  # that no further pulse comes is no event: between pulses of a move the pins are off, too
    last_us = max(edge["t_us"] for edge in board.edges() if edge["pin"].endswith("_en"))
    assert not board.driving()
    assert last_us - begun_us <= KEEP_ALIVE_US + late_us + TICK_US, f"{late_us:.0f} us late"
    client.process.kill()
    client.process.communicate()
    ioc.process.kill()
    ioc.process.wait()
    with Mount.open(str(board.link)) as mount:
        assert mount.x.last_move().reason == mount.y.last_move().reason == wire.KEEP_ALIVE


HANGING = """
import signal, time
from mirrormount.cli.main import main
from mirrormount_epics import cli
class HangingPump(cli.Pump):
    def __init__(self):
        super().__init__()
        signal.signal(signal.SIGUSR1, lambda *_: self.put(lambda: time.sleep(3)))
cli.Pump = HangingPump
main()
"""


def test_moves_that_a_busy_ioc_cuts_short_fail_and_say_what_to_do(board, rests):
    """With 100 axes on a busy computer, the thread that gives signs of life for all mounts may come late."""
    with Ioc(str(board.link), program=("-c", HANGING)) as ioc:
        client = ioc.client("""
            import epics
            from ophyd import EpicsMotor
            x = EpicsMotor(P + "m1:x", name="x"); x.wait_for_connection(timeout=30)
            status = x.set(50)
            wait_for(lambda: x.moving and x.position > 0, "the first step")
            event("moving")
            wait_for(lambda: status.done, "its end")
            assert not status.success, status
            assert 0 < x.position < 50, x.position
            why = epics.caget(P + "m1.MSG$", as_string=True)
            assert "silent for more than 1 s" in why and "--patience" in why, why
            assert epics.caget(P + "m1:x.SEVR") == 2 and epics.caget(P + "m1:x.SPMG") == 0
            event("short")
            assert epics.caput(P + "m1:x.SPMG", 3, wait=True) == 1
            assert x.move(round(x.position) + 1, timeout=30).success
        """)
        client.until("moving")
        ioc.process.send_signal(signal.SIGUSR1)
        client.go_on()
        client.until("short")
        rests()
        client.go_on()
        client.end()


def test_who_waits_across_a_restart_of_the_ioc_knows_that_its_move_was_cut(ioc, board, drives):
    client = ioc.client("""
        import epics
        from ophyd import EpicsMotor
        x = EpicsMotor(P + "m1:x", name="x"); x.wait_for_connection(timeout=30)
        status = x.set(50)
        wait_for(lambda: x.moving, "the move")
        event("moving")
        wait_for(lambda: status.done, "its end")
        assert not status.success
        assert x.user_setpoint.get() == x.position
        assert x.move(round(x.position) + 1, timeout=30).success
    """)
    client.until("moving")
    ioc.process.kill()
    ioc.process.wait()
    with Ioc(str(board.link), environment=ioc.environment):
        client.go_on()
        client.end()


def test_a_board_that_goes_in_mid_move_is_an_alarm_and_comes_back_at_rest(ioc, board, drives):
    client = ioc.client("""
        import epics
        axis = P + "m1:x."
        epics.caput(axis + "VAL", 50); wait_for(lambda: epics.caget(axis + "MOVN") == 1, "the move")
        event("moving")
        wait_for(lambda: epics.caget(axis + "SEVR") == 3 and epics.caget(axis + "DMOV") == 1, "the alarm")
        assert epics.caget(P + "m1.CONN") == 0 and epics.caget(axis + "STAT") == 9
        epics.caput(axis + "VAL", 1, wait=True, timeout=5)
        assert "board" in epics.caget(axis + "ESTP")
        event("gone")
        wait_for(lambda: epics.caget(P + "m1.CONN") == 1, "the board")
        epics.caput(axis + "VAL", 1, wait=True, timeout=5)
        assert "Go" in epics.caget(axis + "ESTP") and epics.caget(axis + "SPMG") == 0
        event("back")
        assert epics.caput(axis + "SPMG", 3, wait=True, timeout=5) == 1
        assert epics.caput(axis + "VAL", 1, wait=True, timeout=30) == 1
        assert epics.caget(axis + "RBV") == 1 and epics.caget(axis + "SEVR") == 0
    """)
    client.until("moving")
    folder = board.link.parent
    board.kill()
    client.go_on()
    client.until("gone")
    with ServedBoard(folder) as again:
        again_edges = len(again.edges())
        client.go_on()
        client.until("back")
        assert len(again.edges()) == again_edges
        client.go_on()
        client.end()


def test_a_flood_of_puts_ends_with_a_stop_that_is_not_lost(ioc, board, rests):
    ioc.run("""
        import random, epics
        random.seed(1)
        fields = ("VAL", "DVAL", "RLV", "TWF", "JOGF", "JOGR", "STOP", "SPMG", "OFF", "DIR", "HLM")
        pvs = {field: epics.PV(P + "m1:x." + field) for field in fields}
        assert all(pv.wait_for_connection(30) for pv in pvs.values())
        odd = (float("nan"), float("inf"), 1e300, 3.7, -2.2)
        for n in range(3000):
            field = random.choice(fields)
            value = {"VAL": random.choice(odd), "DVAL": random.uniform(-5, 5), "RLV": random.uniform(-2, 2),
                     "SPMG": random.choice((0, 1, 2, 3)), "OFF": random.uniform(-1, 1), "DIR": n % 2,
                     "HLM": random.choice((-3, 3, 1e5))}.get(field, 1)
            pvs[field].put(value)
        pvs["SPMG"].put(3)
        assert pvs["STOP"].put(1, wait=True, timeout=30) == 1
        wait_for(lambda: epics.caget(P + "m1:x.DMOV") == 1 and epics.caget(P + "m1:x.MOVN") == 0, "rest")
    """)
    rests()
    edges = len(board.edges())
    assert ioc.run('import epics; print(epics.caget(P + "m1:x.DMOV"))')[-1] == "1"
    assert len(board.edges()) == edges and ioc.process.poll() is None
    assert not any("fault" in line for line in ioc.errors), ioc.errors


def test_words_put_to_numbers_are_refused_and_all_is_as_it_was(ioc, board):
    ioc.run("""
        import asyncio
        from aioca import caget, caput, DBR_STRING
        axis = P + "m1:x."
        fields = ("VAL", "DVAL", "RVAL", "RLV", "TWF", "JOGF", "HOMF", "STOP", "SPMG", "DIR", "OFF", "SET", "HLM")
        async def shown():
            return [await caget(axis + field) for field in (*fields, "DMOV", "MSTA", "FOFF", "PREC", "TWV")]
        async def main():
            await caput(axis + "SPMG", 2, wait=True)
            before = await shown()
            for field in (*fields, "PREC", "TWV", "FOFF"):
                for wait in (False, True):  # EPICS base processes the record after the second kind only
                    done = await caput(axis + field, "fast", datatype=DBR_STRING, wait=wait, timeout=20, throw=False)
                    assert done.ok != wait, field
                    assert await shown() == before, (field, before, await shown())
            assert not (await caput(P + "m1.STOP", "now", datatype=DBR_STRING, wait=True, throw=False)).ok
            await caput(axis + "SPMG", "Go", datatype=DBR_STRING, wait=True)
            await caput(axis + "VAL", "1", datatype=DBR_STRING, wait=True, timeout=30)  # a number in words is one
            assert await caget(axis + "RBV") == 1
        asyncio.run(main())
    """)


def test_an_axis_whose_board_was_never_there_has_limits(board, tmp_path):
    with Ioc(str(board.link), str(tmp_path / "nothing")) as ioc:
        ioc.run("""
            import epics
            for axis in ("m1:x", "m2:x", "m2:y"):
                low, high = (epics.caget(P + axis + field) for field in (".LLM", ".HLM"))
                assert low < 0 < high, (axis, low, high)
        """)


def rubbish(rng: random.Random, n: int, protocol: str) -> bytes:
    """Random bytes, most of them behind the beginning of a message that the server knows."""
    body = rng.randbytes(rng.randrange(0, 200))
    if rng.random() < 0.3:
        return body
    if protocol == "PVA":
        flags, command = rng.choice((0, 0x40, 0x80)), rng.randrange(0, 24)
        size = rng.choice((len(body), rng.randrange(0, 1 << 32)))
        return (
            bytes((0xCA, rng.choice((1, 2)), flags, command)) + size.to_bytes(4, rng.choice(("little", "big"))) + body
        )
    command, size = rng.randrange(0, 30), rng.choice((len(body) // 8 * 8, rng.randrange(0, 1 << 16)))
    numbers = [rng.randrange(0, 1 << 16), rng.randrange(0, 1 << 16)]
    head = b"".join(number.to_bytes(2, "big") for number in (command, size, *numbers))
    return head + rng.randbytes(8) + body


@pytest.mark.parametrize(
    ("protocol", "n"),
    [
        ("CA", 300),
        ("PVA", 40),  # fewer: after such packets EPICS base is slow to accept the next connection
        pytest.param("CA", 100_000, marks=pytest.mark.full),
    ],
)
def test_malformed_packets_move_nothing_and_the_ioc_goes_on(ioc, board, protocol, n):
    send_rubbish(ioc, n, protocol)
    assert board.edges() == [] and ioc.process.poll() is None
    ioc.run(ALIVE)


@pytest.mark.full
def test_malformed_packets_of_pvaccess_move_nothing_though_they_may_end_the_ioc(ioc, board):
    """EPICS base's server of PVAccess crashes at some of them; a bare IOC of epicscorelibs does the same."""
    send_rubbish(ioc, 3000, "PVA")
    assert board.edges() == []
    ioc.process.kill()
    with Ioc(str(board.link), environment=ioc.environment) as again:
        again.run(ALIVE)


ALIVE = """
import epics
assert epics.caget(P + "m1:x.RBV") == 0
assert epics.caput(P + "m1:x.VAL", 1, wait=True, timeout=30) == 1
"""


def send_rubbish(ioc: Ioc, n: int, protocol: str) -> None:
    """Until the IOC ends, at most n."""
    rng = random.Random(n)
    where = ("127.0.0.1", ioc.port(protocol))
    with socket.socket(type=socket.SOCK_DGRAM) as udp:
        for _ in range(n // 10):
            with contextlib.suppress(OSError), socket.create_connection(where, timeout=1) as tcp:  # it may hang up
                for _ in range(9):
                    tcp.sendall(rubbish(rng, n, protocol))
            udp.sendto(rubbish(rng, n, protocol), where)
            if ioc.process.poll() is not None:
                return


@pytest.mark.full
def test_an_ioc_that_a_client_of_pvaccess_locks_stops_its_motors_and_ends(ioc, board, rests):
    """A bare IOC of epicscorelibs hangs for ever."""
    ioc.run("""
        import epics
        from p4p.client.thread import Context, TimeoutError
        epics.caput(P + "m1:x.JOGF", 1); wait_for(lambda: epics.caget(P + "m1:x.MOVN") == 1, "the jog")
        context = Context("pva")
        try:
            context.put(P + "m1:x.RBV", 1.0, wait=True, timeout=2)
        except TimeoutError:
            print("locked")
        context.close()
    """)
    rests()
    assert ioc.process.wait(60) == 1
    ioc._reader.join()
    assert "a record is locked" in ioc.errors[-1]


def test_without_pvaccess_only_channel_access_listens(board):
    with Ioc(str(board.link), "--no-pva") as ioc:
        ioc.run('import epics; assert epics.caget(P + "m1:x.RBV") == 0')
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", ioc.port("PVA")), timeout=5)


DENIED = """
import epics
from p4p.client.thread import Context
context = Context("pva")
def denied(put):
    try:
        put()
    except Exception as e:
        return "permitted" in str(e) or "denied" in str(e).lower()
    return False
for field in ("VAL", "JOGF", "HLM", "SPMG", "OFF"):
    assert denied(lambda: epics.caput(P + "m1:x." + field, 1, wait=True, timeout=5)), field
    assert denied(lambda: context.put(P + "m1:x." + field, 1, timeout=5)), field
assert epics.caget(P + "m1:x.RBV") == float(context.get(P + "m1:x.RBV")) == 0
context.close()
"""


def test_read_only_denies_each_put_but_a_stop(board):
    with Ioc(str(board.link), "--read-only") as ioc:
        ioc.run(DENIED + 'assert epics.caput(P + "m1:x.STOP", 1, wait=True, timeout=5) == 1\n')
    assert board.edges() == []


def test_rules_of_access_are_those_of_the_file(board, tmp_path):
    rules = tmp_path / "rules.acf"
    rules.write_text("UAG(operators) {nobody-here}\nASG(DEFAULT) {RULE(1, READ) RULE(1, WRITE) {UAG(operators)}}\n")
    with Ioc(str(board.link), "--acf", str(rules)) as ioc:
        ioc.run(DENIED)
    assert board.edges() == []


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="Linux tells who listens")
def test_it_listens_on_loopback_only(ioc):
    listening = set()
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        _, where, _, state = line.split()[:4]
        address, _, port = where.partition(":")
        if state == "0A" and int(port, 16) in (ioc.port("CA"), ioc.port("PVA")):
            listening.add((address, int(port, 16)))
    assert listening == {("0100007F", ioc.port("CA")), ("0100007F", ioc.port("PVA"))}


# ---- the command


def test_the_list_has_every_field_with_its_meaning():
    done = run_cli("ioc", "--list", "--prefix", "LAB:", "--virtual", "--cameras", "1")
    assert done.returncode == 0
    assert {"LAB:m1:x:certainty", "LAB:c1:x,", "LAB:table:loop:error,"} <= set(done.stdout.split())
    for field in (*fields.MOTOR, *fields.MOUNT, *fields.CAMERA, *fields.LOOP):
        assert f" .{field.name}" in done.stdout or f" {field.name}" in done.stdout


def test_the_screen_has_every_motor_the_stop_the_cameras_and_the_loop(tmp_path):
    import xml.etree.ElementTree as xml

    screen = ("--screen", str(tmp_path / "mounts.bob"))
    done = run_cli("ioc", "--virtual", "--cameras", "1", "--prefix", "LAB:", *screen)
    assert done.returncode == 0, done.stderr
    named = {element.text for element in xml.parse(tmp_path / "mounts.bob").iter("pv_name")}
    assert {"LAB:m1.STOP", "LAB:m1:x.VAL", "LAB:m1:y.STOP", "LAB:c1.X", "LAB:table:loop.HOLD"} <= named


def test_the_longest_names_are_no_longer_than_epics_has_room_for(tmp_path):
    table = tmp_path / "table.toml"
    table.write_text(f'[mounts.{"m" * 31}]\nport = "virtual://"\n[cameras.{"c" * 31}]\ncamera = "0"\n')
    done = run_cli("--table", str(table), "ioc", "--list", "--prefix", "P" * 17)
    names = [word.strip(",") for word in done.stdout.split() if word.startswith("PPP")]
    assert max(map(len, names)) == 60


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--host", "0.0.0.0"), "--acf"),
        (("--read-only", "--acf", "x"), "one of them"),
        (("--acf", "/nowhere/x"), "/nowhere/x"),
        (("--prefix", "a b"), "--prefix"),
        (("--prefix", "P" * 18), "--prefix"),
    ],
)
def test_what_cannot_be_served_is_told_in_one_line(words, told):
    done = run_cli("ioc", "--virtual", *words)
    assert done.returncode == 1 and told in done.stderr and done.stderr.count("\n") == 1


def test_a_file_of_rules_that_epics_cannot_read_starts_nothing(board, tmp_path):
    import subprocess
    import sys

    rules = tmp_path / "rules.acf"
    rules.write_text("ASG(DEFAULT) { RULE(")
    command = [sys.executable, "-m", "mirrormount", "ioc", str(board.link), "--acf", str(rules)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and "mirrormount:" in done.stderr and "ready" not in done.stdout
