"""Draw docs/images/mount.png: a mount with x, y, motor 1 and motor 2: python tools/mount_picture.py

A sketch, not to scale. Needs matplotlib.
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

IMAGE = Path(__file__).resolve().parent.parent / "docs" / "images" / "mount.png"
RED, BLUE, GREEN, GREY = "#b00020", "#0b5394", "#1b6b2f", "#555555"
PIVOT, MOTOR_1, MOTOR_2 = (1.0, 1.0), (1.0, 3.6), (3.6, 1.0)


def arrow(ax: Axes, start: tuple[float, float], end: tuple[float, float], color: str, head: str = "-|>") -> None:
    """An arrow between two points."""
    ax.annotate("", end, start, arrowprops={"arrowstyle": head, "color": color, "lw": 2.2})


def mount(ax: Axes) -> None:
    """The mount, seen along the beam that comes from it: what is right here is right on the screen."""
    ax.add_patch(FancyBboxPatch((0.5, 0.5), 3.6, 3.6, boxstyle="round,pad=0.1", fc="#dddddd", ec=GREY))
    ax.add_patch(Circle((2.45, 2.45), 0.95, fc="#cfe2f3", ec=BLUE))
    ax.text(2.45, 2.45, "mirror", ha="center", va="center")
    ax.add_patch(Circle(PIVOT, 0.14, color="black"))
    ax.text(0.92, 0.6, "pivot", ha="center", va="center", fontsize=9)
    for (x, y), color, text in ((MOTOR_1, BLUE, "motor 1: y"), (MOTOR_2, GREEN, "motor 2: x")):
        ax.add_patch(Circle((x, y), 0.28, color=color))
        ax.text(x, y + 0.72 if y > 2 else y - 0.95, text, ha="center", color=color, fontsize=12, fontweight="bold")
    ax.plot(*zip(PIVOT, MOTOR_2, strict=True), ls=":", color=BLUE)
    ax.plot(*zip(PIVOT, MOTOR_1, strict=True), ls=":", color=GREEN)
    ax.text(2.3, 1.1, "turns about this line: y", color=BLUE, ha="center", fontsize=8)
    ax.text(0.88, 2.3, "turns about this line: x", color=GREEN, va="center", rotation=90, ha="right", fontsize=8)


def screen(ax: Axes) -> None:
    """Where the spot goes."""
    ax.add_patch(Rectangle((6.2, 0.4), 3.8, 3.8, fc="white", ec=GREY))
    arrow(ax, (8.1, 2.3), (9.7, 2.3), GREEN)
    arrow(ax, (8.1, 2.3), (8.1, 3.9), BLUE)
    ax.text(9.0, 1.9, "x + right", color=GREEN, ha="center")
    ax.text(8.2, 3.5, "y + up", color=BLUE)
    ax.add_patch(Circle((8.1, 2.3), 0.16, color=RED))
    ax.text(8.1, 0.7, "screen or camera", ha="center", color=GREY)
    arrow(ax, (3.5, 2.45), (7.9, 2.32), RED, "-")
    ax.text(5.1, 2.6, "beam", color=RED, ha="center")


def main() -> None:
    """Write the picture."""
    figure, ax = plt.subplots(figsize=(8, 3.9), layout="constrained")
    mount(ax)
    screen(ax)
    ax.set_xlim(0.2, 10.2)
    ax.set_ylim(-0.2, 4.8)
    ax.set_aspect("equal")
    ax.axis("off")
    figure.savefig(IMAGE, dpi=110)


if __name__ == "__main__":
    main()
