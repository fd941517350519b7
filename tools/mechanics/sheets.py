# pyright: reportMissingImports=false
"""Dimensioned drawings of the parts on A4 sheets, and pictures of parts and of the built mount. Lengths in mm."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from measures import ARM_WIDTH, FOOT_DIAMETER, RING_HEIGHT, RING_WALL, ROD_OUT, Measures, Place
from solids import COUNT, PARTS

A4 = (210.0, 297.0)
D = "\u2300 "  # diameter
UNTRIED = "Not tried: no part has been printed yet."
COLOURS = {
    "frame": "#9aa3ad", "motor": "#c9b458", "key": "#4a4a4a", "spring": "#777777", "spring_pin": "#333333",
    "rod": "#8c8c8c", "switch": "#3b3b3b", "plate": "#4c86c6", "spring_ring": "#d07a3a", "sleeve": "#c0504d",
    "encoder_cap": "#6aa84f", "switch_bracket": "#8e63b0", "rod_foot": "#3fa7a0",
}  # fmt: skip
FROM = {"top": ((0, 0, 999), (0, 1, 0)), "below": ((0, 0, -999), (0, 1, 0)),
        "front": ((0, -999, 0), (0, 0, 1)), "right": ((999, 0, 0), (0, 0, 1))}  # fmt: skip


@dataclass
class View:
    """A part seen from one side: where its origin is on the sheet, and what is written at it, in the part's mm."""

    side: str
    at: Place
    scale: float
    across: list[tuple[float, float, float, str]] = field(default_factory=list)  # x from, x to, y of the line, words
    upright: list[tuple[float, float, float, str]] = field(default_factory=list)  # y from, y to, x of the line, words
    words: list[tuple[Place, Place, str]] = field(default_factory=list)  # point, place of the words, words


def told(m: Measures, name: str) -> str:
    """A measure as a drawing has it: an estimate has an asterisk."""
    return f"{getattr(m, name):g}" + ("*" if m.sources[name].startswith("estimate") else "")


def views(m: Measures) -> dict[str, list[View]]:
    """The views of each part's sheet."""
    w, h = (size / 2 for size in m.plate_size)
    (x1, y1), (x2, y2) = m.motors
    (rx, ry), _ = m.rods
    (bx, by), _ = m.brackets
    half, side, up = m.motor_screws_apart / 2, m.half_width, m.ring_rise + RING_HEIGHT
    hole = {name: f"{D}{circles[0][2]:.1f}" for name, circles in m.plate_holes().items()}
    long, r, key, (neck, low) = m.sleeve_length, m.sleeve_diameter / 2, m.key_depth, m.neck
    cap_w, cap_h, cap = m.gearbox_width + m.fit, m.gearbox_height + m.fit, m.rear_shaft_length + 14.9
    pair, z, across = m.switch_holes_apart / 2, 3 + m.switch_terminals, 3 + m.switch_thickness / 2
    end = pair + m.switch_screw / 2 + 1.7
    nut, foot, spring = m.nut_height + 0.6, FOOT_DIAMETER / 2, m.spring_hole / 2
    ring_foot = up + m.side_hole
    flat = f"flat {m.shaft_flat + m.fit / 2:.1f}* from the other side"
    set_screw = f"2 x {D}{told(m, 'set_screw_pilot')}, tap M3,\non the flat's side only"
    plate_note = f"1:1, to lay on the mount.\n{told(m, 'plate_thickness')} thick. Rod and M3 at motor 2:\n"
    nut_note = f"{D}{m.rod_diameter + m.fit:.1f}, below a hexagon\n{m.nut_width + m.fit:.1f} across its flats"
    return {
        "plate": [
            View("top", (105, 195), 1.5,
                 [(x1, x2, -h - 9, told(m, "adjusters_x")), (-w, w, -h - 16, f"{2 * w:g}"),
                  (-w, x1, h + 5, told(m, "plate_edge")), (x1, 0, h + 5, f"{-x1:.2f}"),
                  (x1 - half, x1 + half, h + 11, told(m, "motor_screws_apart"))],
                 [(y2, y1, w + 9, told(m, "adjusters_y")), (-h, h, w + 16, f"{2 * h:g}"),
                  (ry, y1, -w - 6, f"{y1 - ry:g}"), (by + 3.5, ry, -w - 6, f"{ry - by - 3.5:.2f}"),
                  (by - 3.5, by + 3.5, -w - 6, "7")],
                 [((x1 + 1.5, y1 + 1.5), (x1 + 9, y1 + 4), f"2 x {hole['shaft']}*, motor's shaft"),
                  ((x2 + half, y2 + 0.9), (x2 - 9, y2 + 9), f"4 x {hole['motor screw']}, M1.6"),
                  ((2.5, 2.5), (6, 4), f"{hole['spring']}*, spring"),
                  ((rx + 3, ry), (rx + 6, ry + 2), f"2 x {hole['rod']}, rod, {ROD_OUT:g} left of the shaft"),
                  ((bx + 1.6, by - 3.5), (bx + 5, by - 3.5), f"4 x {hole['bracket screw']}, M3")]),
            View("top", (105, 75), 1,
                 words=[((-w - 56, -h), (-w - 56, -h), plate_note + "the same, x and y exchanged.")])],
        "spring_ring": [
            View("front", (130, 195), 2, [(-side, 0, -8, told(m, "half_width")), (-side - 5, -side, -8, "5")],
                 [(0, ring_foot, -side - 12, f"{ring_foot:.1f}*"), (0, RING_HEIGHT, 12, f"{RING_HEIGHT:g}"),
                  (0, ring_foot + 7, -side - 18, f"{ring_foot + 7:.1f}*")],
                 [((-side, ring_foot), (8 - side, ring_foot + 2), f"{D}{m.side_screw + 0.3:.1f}, 8-32 or M4"),
                  ((0.8, RING_HEIGHT / 2), (4, 14), f"{D}{m.spring_pin + m.fit:.1f}, pin")]),
            View("top", (130, 95), 2, [(-spring, spring, -12, f"{D}{2 * spring:.2f}*")],
                 [(-ARM_WIDTH / 2, ARM_WIDTH / 2, -side - 10, f"{ARM_WIDTH:g}")],
                 [((5.3, 5.3), (10, 9), f"{D}{2 * (spring + RING_WALL):.2f}*")])],
        "sleeve": [
            View("front", (95, 155), 3,
                 [(-r, r, long + 4, D + told(m, "sleeve_diameter")), (-neck / 2, neck / 2, -4, f"{D}{neck:g}")],
                 [(0, m.bore_depth, -r - 4, f"{m.bore_depth:g}"), (long - key, long, -r - 4, told(m, "key_depth")),
                  (0, long, -r - 9, f"{long:g}"), (0, low, r + 3, f"{low:g}"),
                  (0, low + 2.5, r + 8, f"{low + 2.5:g}"), (long - key / 2, long, r + 3, f"{key / 2:g}")],
                 [((r, long - key / 2), (r + 6, long - 9), set_screw)]),
            View("top", (60, 90), 3,
                 words=[((0.8, 0.9), (-r, r + 3), f"hexagon {m.key_flats + m.fit / 2:.2f} across its flats")]),
            View("below", (140, 90), 3,
                 words=[((-1.2, 0.9), (-r, r + 3), f"{D}{m.shaft_diameter + m.fit:.1f}, {flat}")])],
        "encoder_cap": [
            View("front", (105, 155), 3, [(-cap_w / 2, cap_w / 2, cap + 4, f"{cap_w:.1f} inside"),
                 (-cap_w / 2 - 1.6, cap_w / 2 + 1.6, cap + 9, f"{cap_w + 3.2:.1f}")],
                 [(0, cap, -14, f"{cap:.1f}*"), (0, 2.4, 13, "2.4"), (cap - 10, cap, 16, "10 on the motor")]),
            View("top", (105, 85), 3, [],
                 [(-cap_h / 2, cap_h / 2, -14, f"{cap_h:.1f} inside"),
                  (-cap_h / 2 - 1.6, cap_h / 2 + 1.6, -19, f"{cap_h + 3.2:.1f}"), (-3.5, 3.5, 14, "7")],
                 [((1.8, 1.8), (3, 10), f"{D}5")])],
        "switch_bracket": [
            View("right", (105, 160), 3,
                 [(-pair, pair, z + 7, told(m, "switch_holes_apart")), (-end, end, -5, f"{2 * end:g}")],
                 [(0, z, 13, f"{z:g}*"), (0, z + end - pair, 18, f"{z + end - pair:g}*"), (0, 3, -12, "3")],
                 [((pair + 0.9, z + 0.9), (pair + 5, z + 4), f"2 x {D}{m.switch_screw + 0.2:.1f}")]),
            View("top", (90, 95), 3, [(0, across, -12, f"{across:g}"), (0, 3, 10, "3"),
                 (0, across + 4.8, -17, f"{across + 4.8:g}")], [(-3.5, 3.5, 16, "7")],
                 [((across + 1.1, 4.7), (12, 10), f"2 x {D}3.2")])],
        "rod_foot": [
            View("front", (105, 170), 4, [], [(0, 5, 9, "5"), (0, nut, -9, f"{nut:g}")]),
            View("top", (105, 100), 4, [(-foot, foot, -9, f"{D}{2 * foot:g}")], [], [((1.2, 1.2), (5, 8), nut_note)])],
    }  # fmt: skip


def outline(ax: Axes, solid: Any, view: View) -> None:
    """Visible edges as lines, hidden ones dashed."""
    origin, up = FROM[view.side]
    for edges, style in zip(solid.project_to_viewport(origin, up, (0, 0, 0)), ("-", ":"), strict=True):
        for edge in edges:
            steps = np.linspace(0, 1, 2 if edge.geom_type.name == "LINE" else 40)
            points = np.array([tuple(edge @ float(t))[:2] for t in steps]) * view.scale + view.at
            ax.plot(*points.T, style, color="black", lw=1.0 if style == "-" else 0.5)


def dimensions(ax: Axes, view: View) -> None:
    """The lines and words of a view."""

    def paper(x: float, y: float) -> Place:
        return x * view.scale + view.at[0], y * view.scale + view.at[1]

    behind = {"fc": "white", "ec": "none", "pad": 0.8}
    small: dict[str, Any] = {"fontsize": 8, "ha": "center", "va": "center", "bbox": behind}
    both_ends = {"arrowstyle": "<->", "lw": 0.6, "shrinkA": 0, "shrinkB": 0}
    for is_across, lines in ((True, view.across), (False, view.upright)):
        for a, b, off, words in lines:
            (x0, y0), (x1, y1) = (paper(t, off) if is_across else paper(off, t) for t in (a, b))
            ax.annotate("", (x0, y0), (x1, y1), arrowprops=both_ends)
            dx, dy = (0, 1.5) if is_across else (1.5, 0)
            for x, y in ((x0, y0), (x1, y1)):
                ax.plot((x - dx, x + dx), (y - dy, y + dy), color="black", lw=0.4)
            x, y = (x0 + x1) / 2, (y0 + y1) / 2
            if abs(b - a) * view.scale < 8:  # beside the arrows
                x, y = (max(x0, x1) + 4.5, y0) if is_across else (x0, max(y0, y1) + 3)
            ax.text(x, y, words, rotation=0 if is_across else 90, **small)
    for point, place, words in view.words:
        arrow = {"arrowstyle": "->", "lw": 0.5} if point != place else None
        ax.annotate(words, paper(*point), paper(*place), fontsize=8, arrowprops=arrow)


def sheet(m: Measures, part: str, solid: Any) -> Figure:
    """One part on A4, in its scale when printed at 100 %."""
    figure = plt.figure(figsize=(A4[0] / 25.4, A4[1] / 25.4))
    ax = figure.add_axes((0, 0, 1, 1), xlim=(0, A4[0]), ylim=(0, A4[1]), aspect="equal")
    ax.axis("off")
    seen = views(m)[part]
    for view in seen:
        outline(ax, solid, view)
        dimensions(ax, view)
    ax.add_patch(Rectangle((10, 10), A4[0] - 20, A4[1] - 20, fill=False, lw=0.8))
    ax.plot((15, 65), (22, 22), color="black", lw=2)
    ax.text(40, 24, "50 mm on paper", fontsize=7, ha="center")
    ax.text(15, 282, f"{part.replace('_', ' ')}, {COUNT[part]} x, for {m.name}", fontsize=13, va="top")
    scale, wall = seen[0].scale, m.walls()[part]
    words = f"Scale {scale:g}:1 if printed at 100 %. All lengths in mm. Walls of {wall:.2f} mm or more."
    ax.text(15, 274, words, fontsize=8, va="top")
    ax.text(75, 24, "* an estimate, or made of one: measure yours.\n" + UNTRIED, fontsize=8, va="top")
    return figure


def table(m: Measures) -> Figure:
    """Every measure with its source, on A4."""
    figure = plt.figure(figsize=(A4[0] / 25.4, A4[1] / 25.4))
    figure.text(0.06, 0.95, f"Measures for {m.name}, mm, and where each comes from", fontsize=13)
    for i, name in enumerate(f.name for f in fields(m) if "range" in f.metadata):
        y = 0.92 - 0.0205 * i
        weight = "bold" if m.sources[name].startswith("estimate") else "normal"
        for x, words in ((0.06, name), (0.27, f"{getattr(m, name):g}"), (0.33, m.sources[name])):
            figure.text(x, y, words, fontsize=6.5, weight=weight)
    return figure


def drawings(m: Measures, solids: dict[str, Any], path: Path) -> None:
    """All sheets of a mount as one PDF."""
    with PdfPages(path, metadata={"CreationDate": None}) as pdf:
        for figure in (*(sheet(m, part, solids[part]) for part in PARTS), table(m)):
            pdf.savefig(figure)
            plt.close(figure)


# Pictures


def picture(
    shapes: Sequence[tuple[str, Any]], path: Path, view: Place, labels: Iterable[str] = (), wide: int = 640
) -> None:
    """Shaded solids, hidden surfaces removed by a depth buffer; view: degrees about z and above the horizon.

    Each label names a kind of solid; its line leads to what can be seen of it.
    """
    azimuth, elevation = np.radians(view)
    right = np.array((-np.sin(azimuth), np.cos(azimuth), 0))
    toward = np.array((np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)))
    axes = np.stack((right, np.cross(toward, right), toward))
    meshes = []
    for name, shape in shapes:
        points, triangles = shape.tessellate(0.05, 0.2)
        corners = np.array([tuple(p) for p in points]) @ axes.T
        meshes.append((name, corners[np.array(triangles)]))
    low = np.min([t.min((0, 1)) for _, t in meshes], axis=0)[:2] - 3
    high = np.max([t.max((0, 1)) for _, t in meshes], axis=0)[:2] + 3
    per_mm = 2 * wide / (high - low)[0]  # twice as fine as the picture, which smooths its edges
    size = np.ceil((high - low) * per_mm / 2).astype(int) * 2
    depth = np.full(size[::-1], -np.inf)
    colour, normals = np.ones((*depth.shape, 3)), np.zeros((*depth.shape, 3))
    light = np.array((-0.35, 0.5, 0.79))
    owner = np.full(depth.shape, -1)
    for number, (name, triangles) in enumerate(meshes):
        before = depth.copy()
        rgb = np.array(to_rgb(COLOURS[name]))
        for corners in triangles:
            raster(corners, low, per_mm, depth, colour, normals, rgb, light)
        owner[depth > before] = number
    near = np.where(np.isinf(depth), -1e3, depth)
    lines = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        ahead = [slice(None)] * 2
        behind = [slice(None)] * 2
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        bent = (normals[tuple(ahead)] * normals[tuple(behind)]).sum(-1) < 0.75
        lines[tuple(behind)] |= bent | (np.abs(near[tuple(ahead)] - near[tuple(behind)]) > 1.2)
    colour[lines & ~np.isinf(depth)] *= 0.25
    small = colour.reshape(size[1] // 2, 2, size[0] // 2, 2, 3).mean((1, 3))[::-1]
    spots = {}
    for name in labels:
        seen = np.isin(owner, [i for i, (kind, _) in enumerate(meshes) if kind == name])
        if seen.any():
            numbers = owner[seen]
            pixels = np.argwhere(owner == np.bincount(numbers).argmax())  # of the one that is seen best
            row, column = pixels[np.abs(pixels - np.median(pixels, axis=0)).sum(1).argmin()]
            spots[name] = (column / 2, small.shape[0] - row / 2)
    names = list(spots)
    margin = 0.25 * wide if names else 0
    figure = plt.figure(figsize=((small.shape[1] + 2 * margin) / 100, small.shape[0] / 100), dpi=100)
    ax = figure.add_axes((0, 0, 1, 1), xlim=(-margin, small.shape[1] + margin), ylim=(small.shape[0], 0))
    ax.axis("off")
    ax.imshow(np.clip(small, 0, 1), interpolation="nearest")
    for is_left in (True, False):
        column = sorted((n for n in names if (spots[n][0] < small.shape[1] / 2) == is_left), key=lambda n: spots[n][1])
        heights = [spots[n][1] for n in column]
        for i, (a, b) in enumerate(pairwise(list(heights))):
            heights[i + 1] = max(b, heights[i] + 26, a)
        for name, height in zip(column, heights, strict=True):
            x = -margin + 8 if is_left else small.shape[1] + margin - 8
            arrow = {"arrowstyle": "-", "lw": 0.8}
            ax.plot(*spots[name], "o", color="black", ms=4)
            style: dict[str, Any] = {"fontsize": 12, "ha": "left" if is_left else "right", "va": "center"}
            ax.annotate(name.replace("_", " "), spots[name], (x, height), arrowprops=arrow, **style)
    figure.savefig(path, metadata={"Software": None})
    plt.close(figure)


def raster(corners: Any, low: Any, per_mm: float, depth: Any, colour: Any, normals: Any, rgb: Any, light: Any) -> None:
    """Draw one triangle where nothing is before it."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    if normal[2] <= 0:  # turned away
        return
    normal /= np.linalg.norm(normal)
    (ax, ay), (bx, by), (cx, cy) = flat = (corners[:, :2] - low) * per_mm
    x0, y0 = np.maximum(np.floor(flat.min(0)).astype(int), 0)
    x1, y1 = np.ceil(flat.max(0)).astype(int) + 1
    y, x = np.mgrid[y0 : min(y1, depth.shape[0]), x0 : min(x1, depth.shape[1])] + 0.5
    if y.size == 0 or not (bx - ax) * (cy - ay) - (by - ay) * (cx - ax):
        return
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
    v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
    z = u * corners[0, 2] + v * corners[1, 2] + (1 - u - v) * corners[2, 2]
    place = np.s_[y0 : y0 + z.shape[0], x0 : x0 + z.shape[1]]
    seen = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (z > depth[place])
    depth[place][seen] = z[seen]
    colour[place][seen] = rgb * (0.45 + 0.55 * max(0.0, float(normal @ light)))
    normals[place][seen] = normal
