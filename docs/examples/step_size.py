# Learn: how large a step is, in both directions, with its standard error: the experiment `measure steps`.
from mirrormount_beam.estimates import Result
from mirrormount_beam.experiments import steps
from mirrormount_beam.experiments.rig import MountRig
from mirrormount_beam.observe import SpotObserver
from mirrormount_beam.progress import MeasurementLine
from mirrormount_sim.table import open_table

result = Result("steps")
# real hardware: with Mount.open() as mount, SpotCamera.open("0") as camera, MeasurementLine(mount) as tell:
with (
    open_table("virtual-table://?mounts=1&cameras=1") as table,
    table.mount() as mount,
    table.camera() as camera,
    MeasurementLine(mount) as tell,
):
    steps.run(MountRig(mount, SpotObserver(camera.camera), axes=("x",)), result, tell)

for name, estimate in result.estimates.items():
    print(f"{name:28} {estimate}")
