# Learn: search a beam that the camera does not see, in a spiral, and stay where it is found.
from mirrormount_beam.scan import find
from mirrormount_sim.table import open_table

# real hardware: with Mount.open() as mount, SpotCamera.open("0") as camera:
with open_table("virtual-table://?mounts=1&cameras=1") as table, table.mount() as mount, table.camera() as camera:
    mount.x.step(40)  # off the picture: somebody has touched the mirror
    print(f"before: {camera.spot()}")
    found = find(mount, lambda _: camera.spot(), rings=12, pitch=4)
    print(f"found at x {found.x:+d}, y {found.y:+d} steps, at place {found.places}" if found else "not found")
    print(camera.spot())
