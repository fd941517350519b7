"""`mirrormount measure`: experiments of a mount in front of a camera, their reports, and what follows for the mount.

However an experiment ends (Ctrl-C, SIGTERM and SIGHUP, too), the motors are off, and what was measured is in the
report. What follows from it (a take-up, a step, a scale) is shown with the values before and after, and is saved only
when a person asks for it: no experiment changes the board's settings.
"""

import argparse
import contextlib
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path

from mirrormount import files
from mirrormount.cli.arguments import (
    Command,
    camera_settings,
    from_extra,
    mount_and_camera,
    note,
    number,
    open_option,
    positive,
    tell_page,
    virtual_address,
    virtual_camera,
)
from mirrormount.device import calibration
from mirrormount.device.calibration import beam_per_mirror, take_up
from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue, CannotWrite, MountError, NotCalibrated
from mirrormount.terminal import ended_in_order
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_table
from mirrormount.values import did_you_mean, spelled
from mirrormount_beam import scale as camera_scale
from mirrormount_beam.camera import Camera, Size
from mirrormount_beam.cameras import open_beside_mount, select
from mirrormount_beam.estimates import Result, Tell
from mirrormount_beam.experiments import backlash, drift, square, steps
from mirrormount_beam.experiments.rig import MountRig, Rig
from mirrormount_beam.observe import SpotObserver
from mirrormount_beam.progress import MeasurementLine
from mirrormount_beam.report import BEGINS, NUMBERS_BEGIN, Origin, write_json, write_page
from mirrormount_beam.scale import OF_PX, Optics, Scale
from mountfw import __version__

# ---- what follows from a measurement

OF_USE = ("steps", "backlash", "pulses")  # experiments from which something follows
_SURE = 3.0  # standard errors by which a pulse moves the spot for certain
_PULSE = re.compile(r"\.pulse_([0-9.]+)ms$")


@dataclass(frozen=True)
class Offer:
    """changes: lines with the values before and after. save: does it, and returns what it has done. later: how else."""

    changes: Sequence[str]
    save: Callable[[], str]
    later: str


def apply_result(apply: bool, mount: Mount, axes: Sequence[str], result: Result, optics: Optics) -> None:
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


# ---- the experiment and its report

_INCIDENCE_DEG = 45.0  # of a folding mirror


def run(args: argparse.Namespace) -> None:
    """Run one experiment and write its report. Raises MountError."""
    with from_extra("plot", "the report of a measurement needs"):
        import matplotlib.figure  # noqa: F401  # now, and not after hours of measuring
    work = _experiment(args)
    wanted = _wanted_series(args)
    page: Path = args.report or Path(f"measure-{args.experiment}.html")
    numbers: Path = args.json or page.parent / f"{page.stem}.json"
    if numbers == page:
        raise BadValue(f"the page and the numbers cannot both be {page}")
    for path, begins in ((page, BEGINS), (numbers, NUMBERS_BEGIN)):
        _check_writable(path, begins)
    if args.apply and args.experiment not in OF_USE:
        raise BadValue(f"--apply is of the experiments {', '.join(OF_USE)}")
    with ended_in_order(), _opened(args) as (mount, camera, optics):
        axes = _axes(args.axes, mount)
        if wanted:
            work = partial(_steps_of_size, wanted_px=_in_px(*wanted, axes, optics, camera.size))
        result = Result(args.experiment)
        began = datetime.now().astimezone()
        observer = SpotObserver(camera)
        origin = Origin(began, __version__, mount.identity, camera.name, mount.settings(), optics)
        try:
            with MeasurementLine(mount) as tell, _stopped(mount), mount.unless_stopped(since_open=True):
                work(MountRig(mount, observer, axes), result, tell)
        except BaseException as e:
            result.partial = "stopped by Ctrl-C" if isinstance(e, KeyboardInterrupt) else str(e) or type(e).__name__
            if result.readings:
                _write(page, numbers, result, origin, observer)
                tell_page(page, False)
            raise
        try:
            _write(page, numbers, result, origin, observer)
        finally:
            _summarise(result, optics)
        apply_result(args.apply, mount, axes, result, optics)
        if args.virtual and args.experiment in ("backlash", "pulses"):
            note("this virtual board ends here, and with it what was saved on it")
    tell_page(page, args.open)


def _check_writable(path: Path, begins: str) -> None:
    """Raises CannotWrite now, and not after the measurement. begins: a file that does is replaced, another one kept."""
    if not path.name or not os.access(path.parent, os.W_OK) or path.is_dir() or path.is_symlink():
        raise CannotWrite(f"cannot write {path}: no such folder, no right to, or a link or folder of that name")
    files.check_replaceable(path, begins)
    files.check_writable(path)  # some folders (/proc) seem writable, and take no new file


def _experiment(args: argparse.Namespace) -> Callable[[Rig, Result, Tell], None]:
    if args.minutes is not None and args.experiment != "drift":
        raise BadValue("--minutes is of the experiment drift")
    minutes = number(args.minutes, "--minutes") if args.minutes is not None else drift.DRIFT_S / 60
    if minutes * 60 < drift.LEAST_DRIFT_S:
        least, every = drift.LEAST_DRIFT_S / 60, drift.EVERY_S
        raise BadValue(f"--minutes is {least:g} or more, not {args.minutes}: the spot is read every {every:g} s")
    return {
        "steps": steps.run,
        "backlash": backlash.run,
        "pulses": backlash.run_pulses,
        "square": square.run,
        "drift": partial(drift.drift, seconds=minutes * 60),
        "settle": drift.settle,
    }[args.experiment]


def _wanted_series(args: argparse.Namespace) -> tuple[float, str] | None:
    """The size of a step that is asked for, and its unit."""
    if args.step is None:
        return None
    size, unit = positive(args.step[0], "--step"), spelled(args.step[1])
    if args.experiment != "steps":
        raise BadValue("--step is of the experiment steps")
    if unit not in OF_PX:
        raise BadValue(f"the unit of --step is {', '.join(OF_PX)}, not {unit!r}{did_you_mean(unit, OF_PX)}")
    return size, unit


def _in_px(size: float, unit: str, axes: tuple[str, ...], optics: Optics, picture: Size) -> dict[str, float]:
    """The wanted size for each axis. Raises NotCalibrated; BadValue if a picture of this size cannot show it."""
    found = {axis: size / _known(optics.per_px(unit, axis), unit) for axis in axes}
    for axis, px in found.items():
        if px > min(picture) / 2:
            raise BadValue(f"a step of {size:g} {unit} is {px:.4g} px of {axis}: too large for a picture of {picture}")
    return found


def _known(of_px: float | None, unit: str) -> float:
    if of_px is None:
        raise NotCalibrated(
            f"--step in {unit} needs a scale: --mm-per-px and --distance, or `mirrormount camera scale`"
            " with --distance and --incidence"
        )
    return of_px


def _steps_of_size(rig: Rig, result: Result, tell: Tell, wanted_px: dict[str, float]) -> None:
    """Measure the steps as they are, then find the pulse for the wanted ones."""
    steps.run(rig, result, lambda done, phase: tell(done / 2, phase))
    steps.run_step_size(rig, result, lambda done, phase: tell((1 + done) / 2, phase), wanted_px)


@contextlib.contextmanager
def _opened(args: argparse.Namespace) -> Iterator[tuple[Mount, Camera, Optics]]:
    """The mount, the camera and its scale that the arguments name; closed at the end."""
    address, settings = virtual_address(args, "virtual-table", mounts="1", cameras="2"), camera_settings(args)
    if address is None:
        camera = open_beside_mount(args.camera or os.environ.get("MIRRORMOUNT_CAMERA", "0"), settings)
        with contextlib.closing(camera):
            optics = _optics(args, camera)
            with Mount.open(args.port) as mount:
                yield mount, camera, optics
        return
    which = virtual_camera(args.camera)
    table = open_table(address)
    with contextlib.closing(table):
        camera = table.cameras[which - 1]
        select(camera, settings)
        optics = _optics(args, camera)
        with Mount(Link(table.ports[0])) as mount:
            for axis in mount.axes if args.encoder else ():
                mount.apply({axis.name: axis.measure_counts().settings})
            yield mount, camera, optics


def _optics(args: argparse.Namespace, camera: Camera) -> Optics:
    """The scale of the arguments, else the camera's."""
    if args.mm_per_px is None:
        for name in ("mm_per_px_error", "distance", "distance_error", "incidence"):
            if getattr(args, name) is not None:
                raise BadValue(f"--{name.replace('_', '-')} needs --mm-per-px")
        return Optics(camera_scale.read_if_any(camera, note))
    mm_per_px, mm_error = _length(args.mm_per_px, args.mm_per_px_error, "--mm-per-px")
    distance, distance_error = (None, 0.0)
    if args.distance is not None:
        distance, distance_error = _length(args.distance, args.distance_error, "--distance")
    elif args.distance_error is not None:
        raise BadValue("--distance-error needs --distance")
    incidence = number(args.incidence, "--incidence") if args.incidence is not None else _INCIDENCE_DEG
    if not 0 <= incidence < 90:
        raise BadValue(f"--incidence is 0 to less than 90 degrees, not {args.incidence}")
    return Optics(Scale(*camera.size, mm_per_px, mm_error, distance, distance_error, incidence))


def _length(text: str, error: str | None, what: str) -> tuple[float, float]:
    value, spread = positive(text, what), number(error, f"{what}-error") if error is not None else 0.0
    if not 0 <= spread < value:
        raise BadValue(f"{what}-error is 0 or more, and less than {what}, not {error}")
    return value, spread


def _axes(text: str, mount: Mount) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    return tuple(mount.axis(name).name for name in names)


@contextlib.contextmanager
def _stopped(mount: Mount) -> Iterator[None]:
    """At the end, however it comes, the motors are off; what went wrong before is told rather than a failed stop."""
    try:
        yield
    except BaseException:
        with contextlib.suppress(MountError):
            mount.stop()
        raise
    mount.stop()


def _write(page: Path, numbers: Path, result: Result, origin: Origin, observer: SpotObserver) -> None:
    """Write both files, the small one first. Raises CannotWrite, after both were tried."""
    last = (observer.last[0].image, observer.last[1]) if observer.last else None
    written: list[str] = []
    failed: CannotWrite | None = None
    for what, path, write in (
        ("numbers", numbers, lambda: write_json(numbers, result, origin)),
        ("report", page, lambda: write_page(page, result, origin, last)),
    ):
        try:
            write()
            written.insert(0, f"{what}: {path}")
        except CannotWrite as e:
            failed = failed or e
    if written:
        print(f"{'partial ' if result.partial else ''}{', '.join(written)}")
    if failed:
        raise failed


def _summarise(result: Result, optics: Optics) -> None:
    for name, estimate in result.estimates.items():
        other = optics.shown(estimate) if estimate.unit.startswith("px") else estimate
        print(
            f"  {name:28} {estimate}"
            + (f"  = {other}{' of the beam' * other.unit.startswith('urad')}" * (other is not estimate))
        )
    for remark in result.remarks:
        print(f"  {remark}")


# ---- the command

EXPERIMENTS = ("steps", "backlash", "pulses", "square", "drift", "settle")


def arguments(parser: argparse.ArgumentParser) -> None:
    """The experiment, mount, camera and scale; where the report goes."""
    parser.add_argument("experiment", choices=EXPERIMENTS, help="docs/measure.md says what each of them does")
    mount_and_camera(parser)
    parser.add_argument(
        "--encoder", choices=("motor", "shaft"), help="virtual: an encoder on each motor, or behind it; closed loop"
    )
    parser.add_argument("--axes", default="x,y", metavar="LIST", help="axes to measure, such as x or x,y")
    parser.add_argument("--mm-per-px", metavar="MM", help="mm at the camera for one pixel")
    parser.add_argument("--mm-per-px-error", metavar="MM", help="its standard error (0)")
    parser.add_argument("--distance", metavar="MM", help="from the mirror to the camera's plane, along the beam")
    parser.add_argument("--distance-error", metavar="MM", help="its standard error (0)")
    parser.add_argument("--incidence", metavar="DEGREES", help="between beam and mirror's normal (45)")
    parser.add_argument("--minutes", metavar="M", help="drift: how long (60)")
    parser.add_argument(
        "--step",
        nargs=2,
        metavar=("SIZE", "UNIT"),
        help="steps: find the pulse for a step of this size: px, mm, urad, mrad (of the mirror), beam-urad, beam-mrad",
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="the page (default: measure-EXPERIMENT.html)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all numbers (default: beside the page)")
    open_option(parser)
    parser.add_argument(
        "--apply", action="store_true", help="save what was measured: scales, or take-up or step on the board"
    )


COMMANDS = (
    Command("measure", "measure steps, backlash, pulses, square, drift or settling with a camera", run, arguments),
)
