"""The scale of a camera of the virtual table, which knows it, for `measure` and `scan`."""

from mirrormount.beam.scale import Scale
from mirrormount.virtual.table_camera import TableCamera

_NEAR_MM, _FAR_MM = 400.0, 1600.0  # of the virtual table's cameras from the last mirror
INCIDENCE_DEG = 45.0  # of a folding mirror


def virtual_scale(camera: TableCamera, number: int) -> Scale:
    """The scale of camera 1 (near) or 2 (far) of the virtual table with one mount."""
    distance_mm = (_NEAR_MM, _FAR_MM)[number - 1]
    return Scale(*camera.size, camera.sensor.pixel_mm, 0.0, distance_mm, 0.0, INCIDENCE_DEG)
