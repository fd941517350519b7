# Learn: what backlash does to a square of steps, and how the board takes it up (the paper's Fig. 5).
from math import dist

from mirrormount_sim.table import open_table

SIDES = (("x", 1), ("y", -1), ("x", -1), ("y", 1))  # right, down, left, up


def open_px(mount, camera):
    """Drive a square of 20 steps to a side; how far its end is from its begin, in px of the camera."""
    mount.x.step(-5)  # the last moves before the square: as in the paper, only its ways left and up lose steps
    mount.x.step(5)
    mount.y.step(5)
    mount.y.step(-5)
    begin = camera.spot()
    for axis, way in SIDES:
        mount.axis(axis).step(20 * way)
    end = camera.spot()
    return dist((begin.x, begin.y), (end.x, end.y))


# real hardware: with Mount.open() as mount, SpotCamera.open("0") as camera:
with open_table("virtual-table://?mounts=1&cameras=1") as table, table.mount() as mount, table.camera() as camera:
    mount.apply({"x": {"take_up_us": 0}, "y": {"take_up_us": 0}})
    print(f"open without take-up: {open_px(mount, camera):.1f} px")
    mount.apply({"x": {"take_up_us": 296_000}, "y": {"take_up_us": 296_000}})  # the gap of this virtual mount
    print(f"open with take-up: {open_px(mount, camera):.1f} px")
