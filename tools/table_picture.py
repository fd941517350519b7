"""Draw the virtual table of docs/virtual-board.md, docs/images/table.png: python tools/table_picture.py

The frames are those of the tables' cameras, the beam's way is that of the default geometry. Needs matplotlib.
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from mirrormount_beam.camera import Image
from mirrormount_sim.optics import DEFAULT
from mirrormount_sim.table import VirtualTable, open_table

IMAGE = Path(__file__).resolve().parent.parent / "docs" / "images" / "table.png"
ADDRESSES = ("virtual-table://?profile=smooth&seed=4&off=6", "virtual-table://?profile=rough&seed=4&off=6")
RED, GREY = "#b00020", "#555555"


def frames(address: str) -> tuple[VirtualTable, list[Image]]:
    """The closed table, and the first frame of each of its cameras."""
    with open_table(address) as table:
        return table, [next(camera.frames()) for camera in table.cameras]


def draw_table(ax: Axes) -> None:
    """Laser, mirrors, splitter and cameras, seen from above; metres."""
    first, second = DEFAULT.laser_m, DEFAULT.between_m
    near, far = (first + way for way in DEFAULT.cameras_m)
    ax.plot([0, first, first, far], [0, 0, second, second], color=RED, lw=1.2)
    ax.plot([near, near], [second, second - 0.25], color=RED, lw=1.2)
    for x, y, way in ((first, 0, 1), (first, second, 1)):
        ax.plot([x - 0.08, x + 0.08], [y - 0.08 * way, y + 0.08 * way], color="black", lw=4)
    ax.plot([near - 0.07, near + 0.07], [second + 0.07, second - 0.07], color=GREY, lw=2)
    boxes = ((-0.28, -0.06, "laser"), (near - 0.11, second - 0.37, "camera 1"), (far, second - 0.06, "camera 2"))
    for x, y, name in boxes:
        ax.add_patch(Rectangle((x, y), 0.28 if name != "camera 1" else 0.22, 0.12, color=GREY))
        ax.text(x + 0.13, y - 0.04, name, ha="center", va="top", fontsize=9)
    notes = (
        (first / 2, 0.04, f"{DEFAULT.laser_m:g} m"),
        (first - 0.17, second / 2, f"{DEFAULT.between_m:g} m"),
        ((first + near) / 2, second - 0.12, f"{DEFAULT.cameras_m[0]:g} m"),
        ((near + far) / 2 + 0.08, second + 0.05, f"{DEFAULT.cameras_m[1]:g} m from the second mirror"),
        (first + 0.3, -0.05, "first mount"),
        (first - 0.36, second + 0.02, "second mount"),
    )
    for x, y, text in notes:
        ax.text(x, y, text, ha="center", fontsize=9)
    ax.set_xlim(-0.4, far + 0.45)
    ax.set_ylim(-0.25, second + 0.25)
    ax.set_aspect("equal")
    ax.axis("off")
    ax.set_title("The table from above", fontsize=11)


def main() -> None:
    """Write the image."""
    figure = plt.figure(figsize=(9, 9.4), layout="constrained")
    rows = figure.add_gridspec(3, 2, height_ratios=(0.7, 1, 1))
    draw_table(figure.add_subplot(rows[0, :]))
    for row, address in enumerate(ADDRESSES, 1):
        table, seen = frames(address)
        for column, (camera, frame) in enumerate(zip(table.cameras, seen, strict=True)):
            ax = figure.add_subplot(rows[row, column])
            width, height = camera.size
            brightest = frame.image.reshape(height // 2, 2, width // 2, 2).max(axis=(1, 3))  # hot pixels stay visible
            ax.imshow(brightest, cmap="gray", vmin=0, vmax=255, extent=(-0.5, width - 0.5, height - 0.5, -0.5))
            name = address.partition("profile=")[2].partition("&")[0]
            ax.set_title(f"{name}: camera {column + 1}, {camera.size}", fontsize=11)
            ax.set_xlabel("x (pixels)")
            ax.set_ylabel("y (pixels)")
    figure.savefig(IMAGE, dpi=90)


if __name__ == "__main__":
    main()
