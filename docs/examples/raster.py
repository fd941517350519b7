# Learn: a raster of 5 x 5 places, and the spot's place at each, as CSV and as HDF5.
from pathlib import Path

from mirrormount_beam.progress import ScanLine
from mirrormount_beam.scan import COMPLETE, CsvFile, Hdf5File, metadata, raster, scan, spot_signal
from mirrormount_sim.table import open_table

pattern = raster(5, 5, pitch=2)
# real hardware: with Mount.open() as mount, SpotCamera.open("0") as camera:
with open_table("virtual-table://?mounts=1&cameras=1") as table, table.mount() as mount, table.camera() as camera:
    signal = spot_signal(camera.camera)
    about = metadata(mount, pattern, signal)
    as_csv, as_hdf5 = CsvFile(Path("raster.csv"), about, signal), Hdf5File(Path("raster.h5"), about, signal, 25)
    samples, ended = [], "cut off"
    try:
        with ScanLine(pattern) as tell:
            for sample in scan(mount, pattern, signal, back=True):
                tell(sample)
                as_csv.add(sample)
                samples.append(sample)
        ended = COMPLETE
    finally:  # also after Ctrl-C: what was measured by then is kept
        as_csv.end(ended)
        as_hdf5.end(samples, ended)
print(f"{len(samples)} places: raster.csv, raster.h5")
