"""`mirrormount demo`: the paper's test on a virtual board. A square of 20 steps, seen on the screen.

It is driven twice: as the paper did, and with the backlash that this has shown taken up by the board. With encoders,
whose steps do not scatter, both begin and end when the spot creeps no more, and the steps that would have closed the
first one tell the take-up.
Everything in the tables is measured from centroids of pictures of the spot, and the spot is where
the pins that the firmware drove have put it. If the figures are not the paper's, or the second
square does not close, the demo fails.
"""

import importlib.util
import io
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mirrormount import files
from mirrormount.device.axis import Counted
from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue, DemoFailed, ExtraMissing
from mirrormount.terminal import install_command
from mirrormount_sim.bench import BACKLASH_X_MRAD, BACKLASH_Y_MRAD, SCREEN_MM, STEP_X_MRAD, STEP_Y_MRAD
from mirrormount_sim.optics import View
from mirrormount_sim.profiles import HARDWARE

VIEW = View(-100, 100, -100, 100, pixel=0.4)  # mm: the square fits whichever way a swapped wire turns it
WIDE = View(-130, 130, -130, 130, VIEW.pixel)  # the same at up to 130 % of the motors' supply


# ---- the picture


def draw(title: str, first, second, gaps: Sequence[tuple[str, str]], output: Path) -> None:
    """Like the paper's Fig. 5: the pictures of the corners laid over each other, centroids in red.

    first and second are what square() returns; gaps tells of both what is left open across and up. Raises CannotWrite.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, (ax, zoom, after) = plt.subplots(
        1, 3, figsize=(15, 5.4), layout="constrained", gridspec_kw={"width_ratios": (1.25, 1, 1)}
    )
    corners, trail, pictures = first
    _draw_square(ax, corners, trail, pictures)
    ax.set_title(title)
    _draw_gap(zoom, corners, pictures, *gaps[0])
    zoom.set_title("the gap that backlash leaves")
    _draw_gap(after, second[0], second[2], *gaps[1])
    after.set_title("the same corner with the backlash taken up")
    for a in (ax, zoom, after):
        a.set_xlabel("right on the screen (mm)")
        a.set_ylabel("up on the screen (mm)")
    picture = io.BytesIO()
    figure.savefig(picture, dpi=120, format=output.suffix.lower().removeprefix("."))
    plt.close(figure)
    files.write_atomic(files.behind_link(output), picture.getvalue())


def _show(ax, pictures) -> None:
    overlay = np.max(np.stack(pictures), axis=0)
    extent = next((v.left, v.right, v.bottom, v.top) for v in (VIEW, WIDE) if v.shape == overlay.shape)
    ax.imshow(overlay, cmap="gray", extent=extent, vmin=0, vmax=255)


def _draw_square(ax, corners, trail, pictures) -> None:
    """The whole way, its corners numbered."""
    _show(ax, pictures)
    x, y = np.array(trail).T
    ax.plot(x, y, color="tab:orange", lw=0.8, alpha=0.8)
    places = {0: (14, 12), 1: (-12, 12), 2: (-12, -14), 3: (12, -14), 4: (14, -12)}
    for number, corner in enumerate(corners):
        ax.plot(*corner, "+", color="red", ms=12, mew=1.6)
        label = {"textcoords": "offset points", "color": "white", "ha": "center", "va": "center"}
        ax.annotate(f"{number + 1}", corner, places[number], **label)
    x, y = np.array(corners).T
    ax.set_xlim(x.min() - 12, x.max() + 12)
    ax.set_ylim(y.min() - 12, y.max() + 12)


def _draw_gap(ax, corners, pictures, across: str, up: str) -> None:
    """The place where the way begins and ends, and how far apart the two are."""
    _show(ax, pictures)
    (x1, y1), (x5, y5) = corners[0], corners[4]
    for corner in corners:
        ax.plot(*corner, "+", color="red", ms=12, mew=1.6)
    side = 12
    ax.set_xlim((x1 + x5) / 2 - side, (x1 + x5) / 2 + side)
    ax.set_ylim((y1 + y5) / 2 - side, (y1 + y5) / 2 + side)
    style = {"color": "cyan", "textcoords": "offset points", "fontsize": 10}
    style["bbox"] = {"boxstyle": "round,pad=0.2", "fc": "black", "ec": "none", "alpha": 0.6}
    if math.dist((x1, y1), (x5, y5)) < 1:  # too near for arrows between them
        ax.annotate(f"{across} across, {up} up", (x1, y1), (0, -72), ha="center", **style)
        ax.annotate("1: start, 5: end", (x1, y1), (0, 62), textcoords="offset points", color="white", ha="center")
        return
    arrow = {"arrowstyle": "<->", "color": "cyan", "lw": 1.4}
    ax.annotate("", (x1, y5), (x5, y5), arrowprops=arrow)
    ax.annotate("", (x1, y5), (x1, y1), arrowprops=arrow)
    ax.annotate(across, ((x1 + x5) / 2, y5), (0, -16), ha="center", **style)
    ax.annotate(up, (x1, (y1 + y5) / 2), (-6, 0), ha="right", va="center", **style)
    ax.annotate("1: start", (x1, y1), (0, 62), textcoords="offset points", color="white", ha="center")
    ax.annotate("5: end", (x5, y5), (0, -72), textcoords="offset points", color="white", ha="center")


STEPS = 20  # the paper, Fig. 5
_APPROACH = 3  # steps that take up the backlash before the square begins, right and down
_STEP_TOLERANCE = 0.05
_BACKLASH_TOLERANCE = 0.15
_PULSE_US = 200_000  # of a step, as the firmware comes
CLOSES_MRAD = 0.03  # what may be left of the backlash: 20 steps of 0.5 % spread from pulse to pulse allow that
MEASURED_MRAD = 0.01  # the same with encoders: steps that are counted have no spread
_FURTHER = 12  # steps that close a square, at most: the gap of a motor with little supply has six
_CREEP_LOOK_S = 15.0  # between two looks at a spot that may creep ...
_CREEP_LOOKS = 10
_STANDS_MM = 0.02  # ... which it does no more if they are so near: three times the scatter of a centroid
_LEGS = (("x", STEPS, "right"), ("y", -STEPS, "down"), ("x", -STEPS, "left"), ("y", STEPS, "up"))


# ---- the test


@dataclass(frozen=True)
class Row:
    """One line of the table: what, measured and the paper's (mrad), relative tolerance; inf: not the paper's."""

    what: str
    measured: float
    paper: float
    tolerance: float

    @property
    def good(self) -> bool:
        """True if the measurement agrees with the paper within the tolerance."""
        return abs(self.measured - self.paper) <= self.tolerance * self.paper


@dataclass(frozen=True)
class Closure:
    """What is left open along one axis with the backlash taken up, and what may be, in mrad."""

    what: str
    measured: float
    most: float = CLOSES_MRAD

    @property
    def good(self) -> bool:
        """True if the square closes."""
        return abs(self.measured) <= self.most


Corners = list[tuple[float, float]]
Seen = tuple[tuple[float, float], np.ndarray]  # a centroid in mm, and its picture
Look = Callable[[], Seen]


def demonstrate(address: str, output: Path) -> None:
    """Make the square, print the table, draw the picture. Raises DemoFailed if the table is off."""
    if not address.startswith("virtual://"):
        raise BadValue("the demo looks at a virtual board's screen: its port is a virtual:// address")
    if "speed=" not in address:
        address += ("&" if "?" in address else "?") + "speed=max"
    if importlib.util.find_spec("matplotlib") is None:
        raise ExtraMissing(f"the demo draws with matplotlib, which is not installed: {install_command('plot')}")
    _check_writable(output)
    print(f"A virtual board runs the firmware; the square is {STEPS} steps right, down, left, up.")
    with Mount.open(address) as mount:
        encoders = close_loop(mount)
        corners, trail, pictures = square(mount, progress=_progress, waits=bool(encoders))
        rows = table(corners, sees_play=any(found.sees_play for found in encoders))
        print_table(rows)
        x_us, y_us = take_up_by_steps(mount, corners) if encoders else take_up(mount, rows)
        print(
            f"\nThe same, and the board takes up the backlash: XB {x_us / 1000:.0f} and {y_us / 1000:.0f} ms of drive."
        )
        closed = square(mount, progress=_progress, waits=bool(encoders))
        seconds = mount.link.port.simulation.us * 1e-6  # type: ignore[attr-defined]
    closures = closure(closed[0], MEASURED_MRAD if encoders else CLOSES_MRAD)
    print_closures(closures)
    print_hardware()
    title = f"{STEPS} steps right, down, left, up: {rows[0].measured:.2f} and {rows[1].measured:.2f} mrad a step"
    gaps = [_across_and_up(rows[2:4], ".2f"), _across_and_up(closures, "+.3f")]
    draw(title, (corners, trail, pictures), closed, gaps, output)
    print(f"{seconds:.0f} s of the mount's time. The picture is in {output.resolve()}")
    if bad := [row.what for row in rows if not row.good]:
        raise DemoFailed(f"not what the paper measured: {', '.join(bad)}")
    if bad := [row.what for row in closures if not row.good]:
        raise DemoFailed(f"the backlash was not taken up: {', '.join(bad)}")


def close_loop(mount: Mount) -> list[Counted]:
    """Let steps be counted where each axis has an encoder. Returns what was measured of them. Raises MountError."""
    encoders: list[Counted] = []
    if not all(axis.has_encoder for axis in mount.axes):
        return encoders
    for axis in mount.axes:
        found = axis.measure_counts()
        encoders.append(found)
        mount.apply({axis.name: found.settings})
        print(f"{axis.name} has an encoder: closed loop, {found.per_step} counts a step.")
    return encoders


def take_up(mount: Mount, rows: list[Row]) -> tuple[int, int]:
    """Have the board take up the backlash that the table shows. Returns both times, microseconds of drive (x, y).

    A reversal loses as many steps as the backlash is long.
    """
    step_x, step_y, lost_x, lost_y, _ = (row.measured for row in rows)
    return _set_take_up(mount, lost_x / step_x, lost_y / step_y)


def take_up_by_steps(mount: Mount, corners: Corners) -> tuple[int, int]:
    """The same by the steps, left and up, that bring the spot from the square's end to its begin: it drives them.

    They are at the place of the turn, where a screw's periodic error makes steps larger or smaller than the mean of 20.
    Steps that scatter would tell it worse: this is for counted ones. Raises DemoFailed.
    """
    look = camera(mount)
    (x1, y1), *_, (x5, y5) = corners
    lost_x = _steps_until(lambda: mount.x.step(-1), lambda: x1 - at_rest(mount, look)[0][0], x1 - x5)
    lost_y = _steps_until(lambda: mount.y.step(1), lambda: at_rest(mount, look)[0][1] - y1, y5 - y1)
    return _set_take_up(mount, lost_x, lost_y)


def _steps_until(step: Callable[[], object], beyond: Callable[[], float], now: float) -> float:
    """How many steps, and which part of the last one, bring a spot to its goal. beyond: by how much it is past it."""
    for n in range(_FURTHER):
        if now >= 0:
            return float(n)
        step()
        before, now = now, beyond()
        if now >= 0:
            return n - before / (now - before)
    raise DemoFailed(f"{_FURTHER} steps more do not close the square")


def _set_take_up(mount: Mount, x_steps: float, y_steps: float) -> tuple[int, int]:
    times_us = round(_PULSE_US * x_steps), round(_PULSE_US * y_steps)
    if min(times_us) < 0:
        raise DemoFailed("this square shows no backlash: what the steps back and there differ by is more than that")
    mount.x.take_up_us, mount.y.take_up_us = times_us
    return times_us


def camera(mount: Mount) -> Look:
    """A camera that sees the screen of a virtual mount: each call is a picture. It raises DemoFailed without a spot."""
    simulation = mount.link.port.simulation  # type: ignore[attr-defined]
    noise = np.random.default_rng(7)
    view = WIDE if simulation.bench.profile.supply > 1 else VIEW

    def look() -> Seen:
        picture = view.picture(simulation.bench.spot_mm(), noise)
        spot = view.centroid(picture)
        if spot is None:
            raise DemoFailed("no spot on the screen")
        return spot, picture

    return look


def at_rest(mount: Mount, look: Look) -> Seen:
    """What is seen once the spot does not creep any more."""
    seen = look()
    for _ in range(_CREEP_LOOKS):
        mount.sleep(_CREEP_LOOK_S)
        before, seen = seen, look()
        if math.dist(before[0], seen[0]) < _STANDS_MM:
            break
    return seen


def square(mount: Mount, progress=lambda text: None, *, waits: bool = False):
    """Drive the square. Returns the five corners and the trail as centroids in mm, and the five pictures.

    waits: it begins when the spot does not creep, and its end is looked at when the spot creeps no more.
    """
    look = camera(mount)
    mount.x.step(_APPROACH)
    mount.y.step(-_APPROACH)
    spot, picture = at_rest(mount, look) if waits else look()
    corners, trail, pictures = [spot], [spot], [picture]
    for axis, steps, way in _LEGS:
        for i in range(abs(steps)):
            mount.axis(axis).step(1 if steps > 0 else -1)
            trail.append(look()[0])
            progress(f"{way}: {i + 1}/{abs(steps)} steps")
        spot, picture = at_rest(mount, look) if waits and way == _LEGS[-1][2] else look()
        corners.append(spot)
        pictures.append(picture)
    progress("")
    return corners, trail, pictures


def _mrad(corners: Corners) -> Corners:
    return [(math.atan2(x, SCREEN_MM) * 1e3, math.atan2(y, SCREEN_MM) * 1e3) for x, y in corners]


def closure(corners: Corners, most: float = CLOSES_MRAD) -> list[Closure]:
    """What is open between the first and the last corner (mm)."""
    (x1, y1), *_, (x5, y5) = _mrad(corners)
    return [Closure("left open, horizontal", x5 - x1, most), Closure("left open, vertical", y1 - y5, most)]


def table(corners: Corners, *, sees_play: bool = False) -> list[Row]:
    """What the paper reports, from the five corners (mm): start, right, down, left, up.

    sees_play: the encoders see that of the gears. So what is left is the couplers', which the paper does not tell.
    """
    (x1, y1), (x2, y2), (_x3, y3), (_x4, _y4), (x5, y5) = _mrad(corners)
    gap_tolerance = math.inf if sees_play else _BACKLASH_TOLERANCE
    # signed along the way each leg must go: a swapped motor makes it negative
    return [
        Row("step, horizontal", (x2 - x1) / STEPS, STEP_X_MRAD, _STEP_TOLERANCE),
        Row("step, vertical", (y2 - y3) / STEPS, STEP_Y_MRAD, _STEP_TOLERANCE),
        Row("backlash, horizontal", x5 - x1, BACKLASH_X_MRAD, gap_tolerance),
        Row("backlash, vertical", y1 - y5, BACKLASH_Y_MRAD, gap_tolerance),
        Row(
            "closure error",
            math.hypot(x5 - x1, y5 - y1),
            math.hypot(BACKLASH_X_MRAD, BACKLASH_Y_MRAD),
            gap_tolerance,
        ),
    ]


def print_table(rows: list[Row]) -> None:
    """The table, in mrad of beam angle."""
    print(f"{'measured from the spot':24}{'here':>12}{'paper':>12}{'within':>9}")
    for row in rows:
        within = f"{row.paper:7.2f} mrad{row.tolerance:8.0%}  {'ok' if row.good else 'NOT OK'}"
        print(
            f"{row.what:24}{row.measured:7.3f} mrad{within if math.isfinite(row.tolerance) else '   of the couplers'}"
        )
    if math.isinf(rows[-1].tolerance):
        print("(the encoders see the gears' play, and take it up; the paper's backlash is that of both)")
    else:
        print("(the paper's closure error is its two backlashes, taken together)")


def print_closures(closures: list[Closure]) -> None:
    """What is left of the backlash, in mrad of beam angle."""
    for row in closures:
        print(f"{row.what:24}{row.measured:+7.3f} mrad{'':12}{row.most:8.2f}  {'ok' if row.good else 'NOT OK'}")


def print_hardware() -> None:
    """What the first square is on a mount like real ones, in mrad."""
    with Mount.open(f"virtual://?speed=max&profile={HARDWARE.name}") as mount:
        step_x, step_y, open_x, open_y, error = (row.measured for row in table(square(mount)[0]))
    print(
        f"\nThe first square on `{HARDWARE.name}`, which sticks, and whose directions differ (not the paper's mount):"
        f"\nstep {step_x:.3f} and {step_y:.3f} mrad, left open {open_x:+.3f} and {open_y:+.3f} mrad,"
        f" closure error {error:.3f} mrad\n"
    )


def _across_and_up(rows: Sequence[Row | Closure], form: str) -> tuple[str, str]:
    across, up = (f"{row.measured:{form}} mrad" for row in rows)
    return across, up


def _check_writable(output: Path) -> None:
    """Find out before the square, not after it, that the picture cannot be written."""
    if output.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise BadValue(f"the picture's name must end in .png, .svg or .pdf, not {str(output)!r}")
    files.check_writable(files.behind_link(output))


def _progress(text: str) -> None:
    if sys.stdout.isatty():
        print(f"\r\x1b[K{text}", end="", flush=True)
    elif text.startswith(("right: 20", "down: 20", "left: 20", "up: 20")):
        print(text, flush=True)
