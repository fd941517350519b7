"""Mounts and spots as devices of Bluesky: ophyd-async, in one process, without EPICS.

    with Supervisor("virtual://") as supervisor, supervisor.join("bluesky") as program:
        program.take_control()
        with init_devices():
            x = MountAxis(supervisor, program, "x")
        RE(scan([], x, -2, 2, 5))

axis.py  an axis that plans move and read
spot.py  the spot in a camera's images, that plans trigger and read
"""

from mirrormount_bluesky.axis import MountAxis
from mirrormount_bluesky.spot import CameraSpot

__all__ = ["CameraSpot", "MountAxis"]
