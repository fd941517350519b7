"""The official images that somebody has put into the folder $MIRRORMOUNT_IMAGES; none is fetched or built."""

import os
from pathlib import Path

from mirrormount_sim.emulator import is_circuitpython

NAME = "MIRRORMOUNT_IMAGES"
FOLDER = os.environ.get(NAME)


def images(*, circuitpython: bool) -> list[Path]:
    """The .uf2 of that folder that hold CircuitPython, or those that hold MicroPython. Raises FileNotFoundError."""
    if not FOLDER:
        return []
    found = sorted(Path(FOLDER).glob("*.uf2"))
    if not found:
        raise FileNotFoundError(f"{NAME}={FOLDER}: there is no .uf2 in it")
    return [image for image in found if is_circuitpython(image) == circuitpython]
