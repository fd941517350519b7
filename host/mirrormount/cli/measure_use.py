"""What follows from a measurement for the mount: shown with the values before and after, saved only when asked for."""

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mirrormount.beam.optics import Optics
from mirrormount.beam.result import Result
from mirrormount.device import calibration
from mirrormount.device.mount import Mount
from mirrormount.device.scale_fit import beam_per_mirror, take_up

OF_USE = ("steps", "backlash", "pulses")  # experiments from which something follows
_SURE = 3.0  # standard errors by which a pulse moves the spot for certain
_PULSE = re.compile(r"\.pulse_([0-9.]+)ms$")


@dataclass(frozen=True)
class Offer:
    """changes: lines with the values before and after. save: does it, and returns what it has done. later: how else."""

    changes: Sequence[str]
    save: Callable[[], str]
    later: str


def use(apply: bool, mount: Mount, axes: Sequence[str], result: Result, optics: Optics) -> None:
    """Offer what follows from the result: save it if `apply`, ask on a terminal, else say how. Raises MountError."""
    make = {"steps": _steps, "backlash": _take_up, "pulses": _step}.get(result.experiment)
    offer = make(mount, axes, result, optics) if make else None
    if offer is None:
        return
    for change in offer.changes:
        print(f"  {change}")
    if apply or _wanted():
        print(offer.save())
    else:
        print(offer.later)


def _wanted() -> bool:
    """The answer of a person at a terminal; anything but yes is no."""
    if not (sys.stdin and sys.stdin.isatty() and sys.stdout.isatty()):
        return False
    try:
        return input("Save this? [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        return False


def _take_up(mount: Mount, axes: Sequence[str], result: Result, _optics: Optics) -> Offer:
    found = {axis: take_up(result.estimates[f"{axis}.take_up"].value) for axis in axes}
    after = {axis: {"take_up_us": us} for axis, (us, _) in found.items()}
    offer = _settings(mount, after, "take_up_us", "The take-up is saved on the board.")
    notes = [f"{axis}: {beyond}" for axis, (_, beyond) in found.items() if beyond]
    return replace(offer, changes=[*offer.changes, *notes])


def _step(mount: Mount, axes: Sequence[str], result: Result, _optics: Optics) -> Offer | None:
    """A step that is shorter than the shortest pulse that moves the mount for certain becomes that long."""
    after: dict[str, dict[str, int]] = {}
    for axis in axes:
        sure = [_sure_us(result, f"{axis}.{way}") for way in ("positive", "negative")]
        now_us = mount.axis(axis).ask_whole("XP?")[0]
        if None in sure:
            print(f"  {axis}: no pulse of these lengths is sure; the step of {now_us} us stays")
        elif now_us < (least := max(us for us in sure if us is not None)):
            after[axis] = {"pulse_us": least}
        else:
            print(f"  {axis}: the step of {now_us} us is not shorter than a sure pulse ({least} us): it stays")
    return _settings(mount, after, "pulse_us", "The step is saved on the board.") if after else None


def _sure_us(result: Result, name: str) -> int | None:
    """The length from which on all pulses moved the spot for certain."""
    sure = None
    pulses = {
        float(m[1]): e for key, e in result.estimates.items() if key.startswith(name) and (m := _PULSE.search(key))
    }
    for ms, estimate in sorted(pulses.items(), reverse=True):
        if estimate.value < _SURE * estimate.error:
            break
        sure = round(ms * 1000)
    return sure


def _settings(mount: Mount, after: dict[str, dict[str, int]], name: str, done: str) -> Offer:
    before = mount.settings()

    def save() -> str:
        mount.apply(after)
        mount.save()
        return done

    return Offer(
        [f"{axis}.{name}: {before[axis][name]} → {values[name]}" for axis, values in after.items()],
        save,
        "\n".join(
            f"to use it: mirrormount config set {axis}.{name} {values[name]} --save" for axis, values in after.items()
        ),
    )


def _steps(mount: Mount, axes: Sequence[str], result: Result, optics: Optics) -> Offer | None:
    """The scales; and the pulses for steps of another size, if they were asked for, with their scales."""
    scales = _scales(mount, axes, result, optics)
    found = {axis: result.estimates.get(f"{axis}.wanted.pulse") for axis in axes}
    after = {axis: {"pulse_us": round(pulse.value)} for axis, pulse in found.items() if pulse}
    if not after:
        print("for steps of another size: --step SIZE UNIT, such as --step 250 urad")
        return scales
    pulses = _settings(mount, after, "pulse_us", "The step is saved on the board.")
    note = "positions and limits count steps of the old size: home or zero the axis, and set its limits again"
    if scales is None:
        return Offer([*pulses.changes, note], pulses.save, pulses.later)
    return Offer(
        [*pulses.changes, *scales.changes, note],
        lambda: f"{pulses.save()}\n{scales.save()}",
        f"{pulses.later}\nthe scales with it: the same with --apply",
    )


def _scales(mount: Mount, axes: Sequence[str], result: Result, optics: Optics) -> Offer | None:
    found = {axis: scale for axis in axes if (scale := _scale(mount, axis, result, optics))}
    if not found:
        print("for a scale in mrad: --mm-per-px and --distance, or `mirrormount camera scale`")
        return None
    numbers = {axis: mount.axis(axis).number for axis in found}
    changes = []
    for axis, scale in found.items():
        before = calibration.read(mount.board_id, numbers[axis])
        for way in ("positive", "negative"):
            was = getattr(before, way) if before else None
            known = "not known" if was is None else f"{was:g}"
            changes.append(f"{axis}, {way}: {known} → {getattr(scale, way):g} mrad a step (of the mirror)")

    def save() -> str:
        path = calibration.write(mount.board_id, {numbers[axis]: scale for axis, scale in found.items()})
        return f"The scales are saved in {path}."

    return Offer(changes, save, "to move in mrad and mm by this scale: the same with --apply")


def _scale(mount: Mount, axis: str, result: Result, optics: Optics) -> calibration.Scale | None:
    """The scale of an axis, if the camera's is known and the axis turns the mirror."""
    if axis not in ("x", "y") or optics.scale is None:
        return None
    step = calibration.Step(*mount.axis(axis).ask_whole("XP?", "XD?", "XI?"))
    name = axis
    if pulse := result.estimates.get(f"{axis}.wanted.pulse"):
        step, name = replace(step, pulse_us=round(pulse.value)), f"{axis}.wanted"
    ways = [optics.mirror_urad(result.estimates[f"{name}.{way}.step"], axis) for way in ("positive", "negative")]
    if ways[0] is None or ways[1] is None:
        return None
    positive, negative = (float(f"{way.value * 1e-3:.4g}") for way in ways if way)
    factor = beam_per_mirror(axis, optics.scale.incidence_deg or 0.0)  # of x it says nothing
    return calibration.Scale(positive, negative, step, float(f"{factor:.4g}"), optics.distance_mm)
