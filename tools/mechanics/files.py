# pyright: reportMissingImports=false
"""Writes the files of the parts: STEP, STL, DXF, drawings, a picture and the bill. make.py starts it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bill
from build123d import ExportDXF, Pos, Unit, export_step, export_stl
from measures import MOUNTS, MeasureError, Measures, find, load
from sheets import drawings, picture, sheet
from solids import COUNT, PARTS, assembly, plate_face

ROOT = Path(__file__).resolve().parents[2]
BUILT = ("frame", "spring_ring", "spring", "spring_pin", "plate", "motor", "sleeve", "key")
SWITCHED = (*BUILT, "rod_foot", "rod", "switch_bracket", "switch", "encoder_cap")
IMAGES = ROOT / "docs" / "images"


def write(m: Measures, folder: Path) -> None:
    """Everything of one mount."""
    folder.mkdir(parents=True, exist_ok=True)
    solids = {name: make(m) for name, make in PARTS.items()}
    for name, solid in solids.items():
        if not (export_step(solid, folder / f"{name}.step") and export_stl(solid, folder / f"{name}.stl", 0.02, 0.2)):
            raise OSError(f"{folder / name}: the file could not be written: is the disk full?")
    write_dxf(m, folder / "plate.dxf")
    drawings(m, solids, folder / "drawings.pdf")
    picture(assembly(m, SWITCHED), folder / "built.png", (-60, 25), SWITCHED)
    bill.write(folder / "bill.csv")


def write_dxf(m: Measures, path: Path) -> None:
    """The plate's outline and holes, in mm, for a laser, a water jet or a mill."""
    dxf = ExportDXF(unit=Unit.MM)
    dxf.add_layer("cut")
    dxf.add_shape(plate_face(m), layer="cut")
    dxf.write(path)


def pictures(m: Measures) -> None:
    """The pictures of docs/build.md."""
    solids = {name: make(m) for name, make in PARTS.items()}
    sheet(m, "plate", solids["plate"]).savefig(IMAGES / "build-plate.png", dpi=80, metadata={"Software": None})
    laid: list[tuple[str, Any]] = []
    across = back = deepest = 0.0
    for name, solid in solids.items():
        for _ in range(COUNT[name]):
            box = solid.bounding_box()
            if across + box.size.X > 120:
                across, back, deepest = 0.0, back - deepest - 12, 0.0
            laid.append((name, Pos(across - box.min.X, back - box.max.Y, 0) * solid))
            across, deepest = across + box.size.X + 8, max(deepest, box.size.Y)
    picture(laid, IMAGES / "build-parts.png", (-75, 45), PARTS, 600)
    drive = [(n, Pos(0, 0, {"motor": 25, "key": -18, "sleeve": -8}.get(n, 0)) * s)
             for n, s in assembly(m, ("plate", "motor", "sleeve", "key"))]  # fmt: skip
    picture(drive, IMAGES / "build-drive.png", (-60, 20), ("plate", "motor", "sleeve", "key"), 480)
    picture(assembly(m, ("frame", "spring_ring")), IMAGES / "build-ring.png", (-120, 35), ("frame", "spring_ring"), 420)
    picture(assembly(m, BUILT), IMAGES / "build-mount.png", (-120, 25), BUILT, 480)
    picture(assembly(m, SWITCHED), IMAGES / "build-switches.png", (-60, 25), SWITCHED, 520)


def main(words: Sequence[str]) -> int:
    """Write what was asked for; one line a mount, one line for what is wrong."""
    known = f"{', '.join(MOUNTS)}, or a TOML file with your measures; without any, all that are known"
    parser = argparse.ArgumentParser(prog="tools/mechanics/make.py", description=__doc__)
    parser.add_argument("mounts", nargs="*", metavar="MOUNT", help=known)
    parser.add_argument("--to", type=Path, default=ROOT / "build" / "mechanics", help="folder (build/mechanics)")
    parser.add_argument("--pictures", action="store_true", help="also draw the pictures of docs/build.md anew")
    options = parser.parse_args(words)
    try:
        mounts = [(name, load(path)) for name, path in find(options.mounts)]
        for name, m in mounts:
            write(m, options.to / name)
            guesses = sum(source.startswith("estimate") for source in m.sources.values())
            print(f"{options.to / name}: parts for {m.name}; {guesses} measures are estimates: see drawings.pdf")
        if options.pictures:
            pictures(load(MOUNTS["u100"]))
    except (MeasureError, OSError) as error:
        print(error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
