"""The cameras of a table and the loop that holds its beam, as records: what raw clients of both protocols see."""

import json

import pytest
from iocs import Ioc
from served import run_cli

PVA = """
from p4p.client.thread import Context
context = Context("pva", nt=False)
def pva(name):
    value = context.get(P + name)
    return value["value"], value["alarm.severity"], value["alarm.status"]
"""
CA = """
import asyncio, math
from aioca import caget, caput, FORMAT_TIME
def ca(name):
    async def get():
        return await caget(P + name, format=FORMAT_TIME, timeout=30)
    return asyncio.run(get())
def put(name, value=1):
    async def do():
        return (await caput(P + name, value, wait=True, timeout=50, throw=False)).ok
    return asyncio.run(do())
"""


def test_the_spot_of_a_camera_follows_the_mount_over_both_protocols():
    with Ioc("--virtual", "--cameras", "1") as ioc:
        ioc.run(
            CA
            + PVA
            + """
wait_for(lambda: ca("c1:x").severity == 0, "a spot")
before = ca("c1:x")
assert 0 < before < 640 and abs(before.timestamp - time.time()) < 50
assert ca("c1:width") > 1 and 0 < ca("c1:sigma-x") < 1 and ca("c1:state") == ca("c1") == 2
assert pva("c1:x")[1] == pva("c1.X")[1] == 0
assert put("m1:x.VAL", 2)
moved_s = time.time()
wait_for(lambda: ca("c1:x").timestamp > moved_s, "an image that was exposed later")
assert abs(ca("c1:x") - before) > 15 and abs(pva("c1:x")[0] - before) > 15  # 14 px a step
context.close()
"""
        )


def test_what_no_camera_tells_is_an_alarm_and_no_number(board, tmp_path, monkeypatch):
    table = tmp_path / "table.toml"
    beside = "virtual-table://?mounts=1&cameras=1&speed=1&off=12&seed=2"  # at the picture's edge
    cameras = f'[cameras.near]\ncamera = "{beside}"\n[cameras.far]\ncamera = "/nowhere/camera"\n'
    table.write_text(f'[mounts.first]\nport = "{board.link}"\n{cameras}')
    monkeypatch.setenv("MIRRORMOUNT_TABLE", str(table))
    with Ioc() as ioc:
        ioc.run(
            CA
            + PVA
            + """
wait_for(lambda: ca("near:state") == 1, "an image without a spot")
assert ca("far:state") == 0 and "nowhere" in ca("far.MSG$")
assert "edge" in ca("near.MSG$")
for camera in ("near", "far"):
    assert ca(camera + ":state").severity == 3
    for name in (":x", ":y", ":sigma-x", ":width", ".X", ".SHAPE"):
        value = ca(camera + name)
        assert math.isnan(value) and value.severity == 3, (camera, name, value)
        number, severity, status = pva(camera + name)
        assert math.isnan(number) and severity == 3 and status == pva(camera + ":x")[2], (camera, name)
    assert not put(camera + ":x", 7) and math.isnan(ca(camera + ":x"))
assert not put("first:x:certainty", 4) and ca("first:x:certainty") == 0
assert ca("first:x").severity == 0  # the mounts go on
assert math.isnan(ca("table:loop:error")) and ca("table:loop:error").severity == 3
context.close()
"""
        )
    assert board.edges() == []


LOOP = CA + "ENDED, HOLDING, CORRECTING, CREEPING, WAITING, STOPPED = range(6)\n"


def test_without_a_calibration_the_loop_says_so_and_takes_no_control():
    with Ioc("--virtual", "--cameras", "1") as ioc:
        ioc.run(
            LOOP
            + """
assert ca("table:loop:state") == ENDED and not put("table:loop.GO")
wait_for(lambda: ca("c1:x").severity == 0, "a spot")
assert put("table:loop.HOLD")
wait_for(lambda: ca("table:loop:state") == STOPPED, "the refusal")
assert ca("table:loop:state").severity == 2 and ca("table:loop.HOLD") == 0
assert "mirrormount calibrate" in ca("table:loop.WHY$")
assert put("m1:x.VAL", 1) and ca("m1:x.RBV") == 1
"""
        )


@pytest.mark.wall_clock  # on a busy computer pictures are late, and the loop stops
def test_the_loop_holds_the_beam_stops_and_gives_the_mount_back(tmp_path):
    saved = tmp_path / "settings" / "table-calibration.json"
    saved.parent.mkdir()
    done = run_cli("calibrate", "--virtual", "--mounts", "1", "--cameras", "1", "--calibration", str(saved))
    assert done.returncode == 0, done.stderr
    response = json.loads(saved.read_text())
    for actuator in response["belongs"]["actuators"]:
        actuator[0] = actuator[0].replace("first", "m1")
    response["belongs"]["cameras"][0][0] = "c1"
    saved.write_text(json.dumps(response))
    before = saved.read_text()
    with Ioc("--virtual", "--cameras", "1") as ioc:
        ioc.run(
            LOOP
            + """
assert put("m1:x.VAL", 2)  # 1.4 mm off
wait_for(lambda: ca("c1:x").severity == 0, "a spot")
assert put("table:loop.HOLD")
wait_for(lambda: ca("table:loop:error") < 100 and ca("table:loop:error").severity == 0, "the beam on its target")
assert ca("table:loop:angle").severity == 0 and ca("m1:x.SPMG") == 0
assert not put("m1:x.VAL", 5) and not put("m1:x.SPMG", 3)  # the loop has control
assert put("m1.STOP")
wait_for(lambda: ca("table:loop:state") == STOPPED, "the stop")
error = ca("table:loop:error")
assert math.isnan(error) and error.severity == 3 and ca("table:loop:state").severity == 2
assert put("table:loop.GO")
wait_for(lambda: ca("table:loop:state") in (HOLDING, CORRECTING, CREEPING), "it to go on")
assert put("table:loop.HOLD", 0)
wait_for(lambda: ca("table:loop:state") == ENDED, "its end")
assert put("m1:x.SPMG", 3) and put("m1:x.RLV", 1) and ca("m1:x.SEVR") == 0
assert put("table:loop.HOLD")
wait_for(lambda: ca("table:loop:state") == HOLDING, "the loop")
"""
        )
        assert ioc.end() == 0
    assert saved.read_text() != before  # what it has learned
