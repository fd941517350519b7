# Learn: bring the light in a fibre to its maximum by nothing but the reading of a power meter.
from mirrormount_beam.control.maximise import maximise
from mirrormount_beam.progress import LoopLine
from mirrormount_beam.table import LocalTable
from mirrormount_sim.table import open_table

# real hardware: with Table.open(with_cameras=False) as table, table.loop("fibre") as loop, LoopLine() as tell:
with open_table("virtual-table://?mounts=1&profile=hardware&off=0.5") as table, LoopLine() as tell:
    loop = LocalTable.of_virtual(table)  # real hardware: loop.take_control()
    found = maximise(loop, table.power, tell)  # table.power: any function that returns a reading

print(f"{'reached' if found.reached else 'NOT reached'}: {found.begin:.3g} at the begin, {found.end:.3g} at the end")
