# Learn: the shortest raster: 5 x 5 places, each approached from one side, and the spot's place in a CSV file.
import csv

from mirrormount_sim.table import open_table

# real hardware: with Mount.open() as mount, SpotCamera.open("0") as camera, open("spots.csv", "x") as file:
with (
    open_table("virtual-table://?mounts=1&cameras=1") as table,
    table.mount() as mount,
    table.camera() as camera,
    open("spots.csv", "x") as file,
):
    rows = csv.writer(file)
    for y in range(5):
        mount.y.move_to(y, approach="+")
        for x in range(5):
            mount.x.move_to(x, approach="+")
            spot = camera.spot()
            rows.writerow([x, y, spot.x, spot.y] if spot else [x, y, spot])
