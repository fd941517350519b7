"""The work of `mirrormount measure`: opens mount and camera, runs the experiment, writes the report, offers its use.

However it ends (Ctrl-C, SIGTERM and SIGHUP, too), the motors are off, and what was measured is in the report. The
board's settings are never changed.
"""

import argparse
import contextlib
import os
from collections.abc import Callable, Iterator
from datetime import datetime
from functools import partial
from pathlib import Path

from mirrormount.beam import html_page
from mirrormount.beam import scale as camera_scale
from mirrormount.beam.camera import Camera, Size
from mirrormount.beam.experiments import backlash, pulses, square, step_size, steps, waiting
from mirrormount.beam.observe import SpotObserver
from mirrormount.beam.open_camera import open_beside_mount
from mirrormount.beam.optics import OF_PX, Optics
from mirrormount.beam.report import NUMBERS_BEGIN, Origin, write_json, write_page
from mirrormount.beam.result import Result, Tell
from mirrormount.beam.rig import MountRig, Rig
from mirrormount.beam.scale import Scale
from mirrormount.cli.command import note, number, positive, virtual_address, virtual_camera
from mirrormount.cli.measure_use import OF_USE, use
from mirrormount.common import whole_file
from mirrormount.common.errors import BadValue, CannotWrite, MountError, NotCalibrated
from mirrormount.common.progress import StatusLine
from mirrormount.common.signals import ended_in_order
from mirrormount.device.mount import Mount
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_table
from mountfw import __version__

_INCIDENCE_DEG = 45.0  # of a folding mirror


def measure(args: argparse.Namespace) -> None:
    """Run one experiment. Raises MountError."""
    work = _experiment(args)
    wanted = _wanted(args)
    page: Path = args.report or Path(f"measure-{args.experiment}.html")
    numbers: Path = args.json or page.parent / f"{page.stem}.json"
    if numbers == page:
        raise BadValue(f"the page and the numbers cannot both be {page}")
    for path, begins in ((page, html_page.BEGINS), (numbers, NUMBERS_BEGIN)):
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
            with _shown(mount) as tell, _stopped(mount), mount.unless_stopped(since_open=True):
                work(MountRig(mount, observer, axes), result, tell)
        except BaseException as e:
            result.partial = "stopped by Ctrl-C" if isinstance(e, KeyboardInterrupt) else str(e) or type(e).__name__
            if result.readings:
                _write(page, numbers, result, origin, observer)
            raise
        try:
            _write(page, numbers, result, origin, observer)
        finally:
            _summarise(result, optics)
        use(args.apply, mount, axes, result, optics)


def _check_writable(path: Path, begins: str) -> None:
    """Raises CannotWrite now, and not after the measurement. begins: a file that does is replaced, another one kept."""
    if not path.name or not os.access(path.parent, os.W_OK) or path.is_dir() or path.is_symlink():
        raise CannotWrite(f"cannot write {path}: no such folder, no right to, or a link or folder of that name")
    whole_file.check_replaceable(path, begins)
    whole_file.check_writable(path)  # /proc lets nobody


def _experiment(args: argparse.Namespace) -> Callable[[Rig, Result, Tell], None]:
    if args.minutes is not None and args.experiment != "drift":
        raise BadValue("--minutes is of the experiment drift")
    minutes = number(args.minutes, "--minutes") if args.minutes is not None else waiting.DRIFT_S / 60
    if minutes * 60 < waiting.LEAST_DRIFT_S:
        least, every = waiting.LEAST_DRIFT_S / 60, waiting.EVERY_S
        raise BadValue(f"--minutes is {least:g} or more, not {args.minutes}: the spot is read every {every:g} s")
    return {
        "steps": steps.run,
        "backlash": backlash.run,
        "pulses": pulses.run,
        "square": square.run,
        "drift": partial(waiting.drift, seconds=minutes * 60),
        "settle": waiting.settle,
    }[args.experiment]


def _wanted(args: argparse.Namespace) -> tuple[float, str] | None:
    """The size of a step that is asked for, and its unit."""
    if args.step is None:
        return None
    size, unit = positive(args.step[0], "--step"), args.step[1]
    if args.experiment != "steps":
        raise BadValue("--step is of the experiment steps")
    if unit not in OF_PX:
        raise BadValue(f"the unit of --step is {', '.join(OF_PX)}, not {unit!r}")
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
    step_size.run(rig, result, lambda done, phase: tell((1 + done) / 2, phase), wanted_px)


@contextlib.contextmanager
def _opened(args: argparse.Namespace) -> Iterator[tuple[Mount, Camera, Optics]]:
    """The mount, the camera and its scale that the arguments name; closed at the end."""
    address = virtual_address(args, "virtual-table", mounts="1", cameras="2")
    if address is None:
        camera = open_beside_mount(args.camera or os.environ.get("MIRRORMOUNT_CAMERA", "0"))
        with contextlib.closing(camera):
            optics = _optics(args, camera)
            with Mount.open(args.port) as mount:
                yield mount, camera, optics
        return
    which = virtual_camera(args.camera)
    table = open_table(address)
    with contextlib.closing(table):
        camera = table.cameras[which - 1]
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
    return Optics(_scale_of(camera, mm_per_px, mm_error, distance, distance_error, incidence))


def _scale_of(
    camera: Camera, mm: float, mm_error: float, distance: float | None, distance_error: float, incidence: float
) -> Scale:
    width, height = camera.size
    return Scale(width, height, mm, mm_error, distance, distance_error, incidence)


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


@contextlib.contextmanager
def _shown(mount: Mount) -> Iterator[Tell]:
    """A line with the part that is done and the time that is left, by the mount's clock."""
    line = StatusLine()
    begun_s = mount.link.monotonic()

    def tell(done: float, phase: str) -> None:
        passed_s = mount.link.monotonic() - begun_s
        left = f", {passed_s * (1 / done - 1) / 60:.1f} min left" if done > 0.02 else ""
        line.show(f"{done:4.0%}{left}  {phase}  (Ctrl-C stops and keeps what was measured)")

    try:
        yield tell
    finally:
        line.end()


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
