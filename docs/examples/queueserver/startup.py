"""Startup file of bluesky-queueserver: the motors of `mirrormount ioc --prefix LAB:`.

redis-server --bind 127.0.0.1
mirrormount ioc --prefix LAB:
start-re-manager --startup-dir docs/examples/queueserver    # writes a list of plans and devices there
qserver environment open
qserver queue add plan '{"name": "mv", "args": ["m1_x", 2]}'
qserver queue start
"""

from bluesky import RunEngine
from bluesky.plan_stubs import mv  # noqa: F401
from bluesky.plans import count, grid_scan, rel_spiral, scan  # noqa: F401
from ophyd_async.core import init_devices
from ophyd_async.epics.motor import Motor

RE = RunEngine({})  # before the devices: they need its event loop
with init_devices():
    m1_x = Motor("ca://LAB:m1:x")
    m1_y = Motor("ca://LAB:m1:y")
