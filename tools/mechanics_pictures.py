"""Draw the effects of `hardware`, docs/images/mechanics-*.png: python tools/mechanics_pictures.py

Lines and filled marks are the bench's, hollow marks and grey bands what was published (docs/mechanics.md has the
sources). Needs matplotlib.
"""

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

sys.path.insert(0, str(Path(__file__).resolve().parent / "bench"))
from increments import LEVER_MM, MEASURED, increments

from mirrormount_sim.bench import LEVER_X_MM, Bench
from mirrormount_sim.mechanics import Drivetrain, Pwm
from mirrormount_sim.optics import Day
from mirrormount_sim.profiles import DAY_S, DETENTS_REV, GAP_REV, HARDWARE, PITCH_MM, Profile

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
RED, BLUE, GREY = "#b00020", "#1f5fa8", "#d0d0d0"
BEAM_URAD = 2 * PITCH_MM / LEVER_X_MM * 1e6  # of the beam, along x, for a turn of the screw
# Gaps at nine places of 40 um of travel (cheap, direct: 0.6 mm), of their mean: made of Kies' records
GAPS = {
    "cheap, direct": (0.93, 0.88, 0.81, 0.79, 0.89, 1.01, 1.12, 1.24, 1.33),
    "cheap, geared": (0.92, 1.02, 0.93, 1.01, 0.92, 1.03, 1.05, 1.14, 0.98),
    "Newport, DC": (0.89, 0.92, 1.08, 1.15, 1.03, 0.94, 1.02, 1.07, 0.90),
    "pancake, direct": (1.20, 1.14, 1.14, 0.97, 0.90, 0.97, 0.93, 0.92, 0.83),
    "pancake, geared": (0.85, 0.88, 0.80, 0.92, 1.12, 1.06, 1.13, 1.13, 1.10),
}


def train_of(**facts: float) -> Drivetrain:
    """A drivetrain of `hardware` without chance, but for these facts."""
    plain: Profile = replace(HARDWARE, pulse_noise=0.0, friction_spread=0.0, gap_spread=0.0, stick_um=0.0, **facts)
    return Drivetrain(LEVER_X_MM, profile=plain, noise=0.0)


def staircase(ax: Axes) -> None:
    """The tip of the screw follows small steps."""
    train = Drivetrain(LEVER_MM, profile=replace(HARDWARE, creep=0.0, periodic=0.0, twist_urad=0.0), chance=5)
    step = 1.25e-6 * LEVER_MM / train.pitch_mm
    asked, made = [0.0], [0.0]
    train.turn(GAP_REV / 2)
    begun = train.mirror_rad
    for k in range(40):
        train.turn(step)
        asked.append(1.25 * (k + 1))
        made.append((train.mirror_rad - begun) * 1e6)
    ax.plot(asked, asked, color=GREY)
    ax.step(asked, made, where="post", color=BLUE)
    ax.set(xlabel="asked, µrad of the mirror", ylabel="made, µrad", title="Stick-slip: steps of 1.25 µrad")


def shares(ax: Axes) -> None:
    """Stuck and double increments of six actuators, and of the bench at their steps."""
    for share, color in (("stuck", RED), ("double", BLUE)):
        at = np.arange(len(MEASURED))
        ours = [100 * getattr(increments(real.step_urad), share) for real in MEASURED]
        ax.plot(at, ours, "o", color=color, label=f"{share}: bench")
        theirs = [100 * getattr(real, share) for real in MEASURED]
        ax.plot(at, theirs, "s", mfc="none", color=color, label="measured", ms=8)
    ax.set_xticks(at, [f"{real.step_urad:.2f}" for real in MEASURED])
    ax.set(
        ylim=(0, 70), xlabel="six actuators by their steps, µrad", ylabel="% of increments", title="Stuck and double"
    )
    ax.legend(ncols=2, fontsize=7, loc="lower left")


def least_duty(hz: int, slow: bool) -> float:
    """The least duty with which the motor starts, in %."""
    train = train_of()
    train.pwm = Pwm(hz, slow)
    for duty in range(1, 101):
        train.rev_s = 0.0
        train.advance(0.1, duty / 100)
        if train.rev_s:
            return duty
    return math.nan


def start(ax: Axes) -> None:
    """The least duty that starts the motor."""
    hz = np.unique(np.geomspace(20, 25_000, 60).astype(int))
    ax.axhspan(25, 30, color=GREY)
    for slow, color, name in ((False, RED, "fast decay"), (True, BLUE, "slow decay")):
        ax.semilogx(hz, [least_duty(int(f), slow) for f in hz], color=color, label=name)
    ax.plot([4000], [least_duty(4000, slow=False)], "o", color=RED)
    ax.text(3500, least_duty(4000, slow=False) + 4, "the firmware's 4 kHz", ha="right", fontsize=7)
    ax.set(ylim=(0, 100), xlabel="PWM, Hz", ylabel="least duty, %", title="The motor starts (grey: forum)")
    ax.legend(fontsize=7, loc="upper left")


def way_of(us: int, **facts: float) -> float:
    """The shaft's way of a pulse, in turns."""
    train = train_of(**facts)
    train.advance(us * 1e-6, 1.0)
    train.advance(1.0, None)
    return train.shaft_rev


def detents(ax: Axes) -> None:
    """Where short pulses end."""
    us = np.arange(0, 5000, 25)
    unit = BEAM_URAD / DETENTS_REV
    for k in range(9):
        ax.axhline(k * unit, color=GREY, lw=0.8)
    ax.plot(us / 1000, [BEAM_URAD * way_of(int(u)) for u in us], color=BLUE)
    ax.set(xlabel="pulse, ms", ylabel="way, µrad of the beam", ylim=(-1, 8.5 * unit), title="Detents (grey: 1/6 turn)")


def coast(ax: Axes) -> None:
    """The way after the end of a pulse, of the whole way."""
    us = np.unique(np.geomspace(3000, 200_000, 60).astype(int))
    for facts, color, name in (({}, BLUE, "hardware"), ({"friction_v": 1 / 3}, RED, "20 mA of 0.36 A alone")):
        parts = []
        for u in us:
            train = train_of(**facts)
            train.advance(u * 1e-6, 1.0)
            driven = train.shaft_rev
            train.advance(2.0, None)
            parts.append(100 * (1 - driven / train.shaft_rev) if train.shaft_rev else math.nan)
        ax.semilogx(us / 1000, parts, color=color, label=name)
    ax.set(xlabel="pulse, ms", ylabel="% of its way after its end", ylim=(0, 100), title="Coast by dry friction")
    ax.legend(fontsize=7)


def gap(ax: Axes) -> None:
    """The gap by place."""
    for name, parts in GAPS.items():
        ax.plot(np.linspace(0.3, 0.7, 9), parts, color="#999999", lw=0.8, marker="o", mfc="none", ms=3, label=name)
    noise = np.random.default_rng(2)
    train = Drivetrain.new(LEVER_X_MM, HARDWARE, noise)
    places, widths = [], []
    for k in range(120):
        way = 1.0 if k % 2 else -1.0
        shaft, screw = train.shaft_rev, train.screw_rev
        train.begin(way, noise)
        train.advance(0.7 if way > 0 else 0.6, way)
        train.advance(1.0, None)
        places.append(screw)
        widths.append((abs(train.shaft_rev - shaft) - abs(train.screw_rev - screw)) / GAP_REV)
    ax.plot(np.array(places[1:]) % 1, widths[1:], ".", color=BLUE)
    ax.set(
        xlim=(0, 1),
        ylim=(0.75, 1.35),
        xlabel="turn of the screw",
        ylabel="gap, of its mean",
        title="Gap (grey: five actuators)",
    )


def twist(ax: Axes) -> None:
    """Both angles of a mirror while one motor drives."""
    bench = Bench(profile=replace(HARDWARE, loose_start=False), seed=3)
    bench.horizontal.turn(GAP_REV / 2)
    ms, seen = np.arange(0, 400, 2), []
    begun = bench.mirrors_rad()[0]
    bench.edge(20_000, "m2_pos", 65535)
    for t in ms:
        if t in (50, 250):
            bench.edge(int(t) * 1000, "m2_en", 65535 if t == 50 else 0)
        bench.advance(int(t) * 1000)
        seen.append([(a - b) * 1e6 for a, b in zip(bench.mirrors_rad()[0], begun, strict=True)])
    x, y = np.array(seen).T
    ax.plot(ms, x, color=BLUE, label="driven")
    ax.plot(ms, 5 * y, color=RED, label="five times the other one")
    ax.set(xlabel="ms", ylabel="µrad of the mirror", title="Twist and cross-talk in a step")
    ax.legend(fontsize=7)


def sag(ax: Axes) -> None:
    """The speed of two motors that start together, and of one alone."""
    ms = np.arange(0, 60)
    for others, color, name in ((0.0, BLUE, "alone"), (1.0, RED, "with another one")):
        train, speeds = train_of(), []
        train.begin(1.0, np.random.default_rng(1), others)
        for _ in ms:
            speeds.append(60 * train.rev_s)
            train.advance(1e-3, 1.0)
        ax.plot(ms, speeds, color=color, label=name)
    ax.axhspan(13 * 2.8 / 6, 13 * 3.6 / 6, color=GREY)
    ax.set(xlabel="ms", ylabel="turns a minute", title="Start (grey: 13 at 6 V, at 2.8 to 3.6 V)")
    ax.legend(fontsize=7, loc="lower right")


def day(ax: Axes) -> None:
    """A mirror's drift over a day."""
    hours = np.linspace(0, 24, 200)
    for phase, color in ((0.0, BLUE), (2.0, RED)):
        drift = Day(HARDWARE.day_urad, phase)
        ax.plot(hours, [drift.at(hour / 24 * DAY_S) * 1e6 for hour in hours], color=color)
    ax.set(xlabel="hours", ylabel="µrad of the mirror", title="The room over a day: two angles")


PAIRS: dict[str, tuple[Callable[[Axes], None], Callable[[Axes], None]]] = {
    "stick": (staircase, shares),
    "start": (start, detents),
    "coast": (coast, sag),
    "gap": (gap, twist),
}


def main() -> None:
    """All pictures."""
    plt.rcParams.update({"font.size": 8, "axes.titlesize": 9, "axes.spines.top": False, "axes.spines.right": False})
    for name, draws in (*PAIRS.items(), ("day", (day,))):
        figure, axes = plt.subplots(1, len(draws), figsize=(3.6 * len(draws), 2.6), squeeze=False)
        for ax, draw in zip(axes[0], draws, strict=True):
            draw(ax)
        figure.tight_layout()
        figure.savefig(IMAGES / f"mechanics-{name}.png", dpi=90)
        plt.close(figure)


if __name__ == "__main__":
    main()
