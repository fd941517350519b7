"""The work of `mirrormount measure`: opens mount and camera, runs the experiment, writes the report, offers its use.

However it ends, the motors are off, the settings are as they were, and what was measured is in the report.
"""

import argparse
import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from datetime import datetime
from functools import partial
from pathlib import Path

from mirrormount.beam import scale as camera_scale
from mirrormount.beam.camera import Camera
from mirrormount.beam.experiments import backlash, pulses, square, step_size, steps, waiting
from mirrormount.beam.observer import Observer
from mirrormount.beam.open_camera import open_camera
from mirrormount.beam.optics import OF_PX, Optics
from mirrormount.beam.report import Origin, write_json, write_page
from mirrormount.beam.result import Result, Tell
from mirrormount.beam.rig import MountRig, Rig, borrowed
from mirrormount.beam.scale import Scale
from mirrormount.cli.command import number, virtual_address, whole
from mirrormount.cli.measure_use import OF_USE, use
from mirrormount.common.errors import BadValue, CannotWrite, NotCalibrated
from mirrormount.common.progress import StatusLine
from mirrormount.device.mount import Mount
from mirrormount.transport.lines import Link
from mirrormount.transport.open import open_table
from mountfw import __version__

_NEEDS_TAKE_UP = ("square",)  # the others are measured without
_NEAR_MM, _FAR_MM = 400.0, 1600.0  # of the virtual table's cameras from the last mirror


def measure(args: argparse.Namespace) -> None:
    """Run one experiment. Raises MountError."""
    work = _experiment(args)
    wanted = _wanted(args)
    page: Path = args.report or Path(f"measure-{args.experiment}.html")
    numbers: Path = args.json or page.parent / f"{page.stem}.json"
    if numbers == page:
        raise BadValue(f"the page and the numbers cannot both be {page}")
    for path in (page, numbers):
        _check_writable(path)
    if args.apply and args.experiment not in OF_USE:
        raise BadValue(f"--apply is of the experiments {', '.join(OF_USE)}")
    with _opened(args) as (mount, camera, optics):
        axes = _axes(args.axes, mount)
        if wanted:
            work = partial(_steps_of_size, wanted_px=_in_px(*wanted, axes, optics))
        result = Result(args.experiment)
        began = datetime.now().astimezone()
        observer = Observer(camera)
        off = {axis: {"take_up_us": 0} for axis in axes} if args.experiment not in _NEEDS_TAKE_UP else {}
        origin = Origin(began, __version__, mount.identity, camera.name, mount.settings(), optics)
        try:
            with _shown(mount) as tell, borrowed(mount, off, print):
                work(MountRig(mount, observer, axes), result, tell)
        except BaseException as e:
            result.partial = "stopped by Ctrl-C" if isinstance(e, KeyboardInterrupt) else str(e) or type(e).__name__
            if result.readings:
                _write(page, numbers, result, origin, observer)
            raise
        _write(page, numbers, result, origin, observer)
        _summarise(result, optics)
        use(args.apply, mount, axes, result, optics)


def _check_writable(path: Path) -> None:
    """Raises CannotWrite now, and not after the measurement."""
    if not path.name or not os.access(path.parent, os.W_OK) or path.is_dir() or path.is_symlink():
        raise CannotWrite(f"cannot write {path}: no such folder, no right to, or a link or folder of that name")
    try:
        handle, trial = tempfile.mkstemp(dir=path.parent)  # beside it, as the file itself comes: /proc lets nobody
        os.close(handle)
        os.unlink(trial)
    except OSError as e:
        raise CannotWrite(f"cannot write {path}: {e.strerror}") from e


def _experiment(args: argparse.Namespace) -> Callable[[Rig, Result, Tell], None]:
    if args.minutes is not None and args.experiment != "drift":
        raise BadValue("--minutes is of the experiment drift")
    minutes = number(args.minutes, "--minutes") if args.minutes is not None else waiting.DRIFT_S / 60
    if minutes <= 0:
        raise BadValue("--minutes must be more than 0")
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
    size, unit = number(args.step[0], "--step"), args.step[1]
    if args.experiment != "steps":
        raise BadValue("--step is of the experiment steps")
    if size <= 0:
        raise BadValue("--step is more than 0")
    if unit not in OF_PX:
        raise BadValue(f"the unit of --step is {', '.join(OF_PX)}, not {unit!r}")
    return size, unit


def _in_px(size: float, unit: str, axes: tuple[str, ...], optics: Optics) -> dict[str, float]:
    """The wanted size for each axis. Raises NotCalibrated."""
    found = {axis: optics.per_px(unit, axis) for axis in axes}
    return {axis: size / _known(of_px, unit) for axis, of_px in found.items()}


def _known(of_px: float | None, unit: str) -> float:
    if of_px is None:
        raise NotCalibrated(
            f"--step in {unit} needs a scale: --mm-per-px and --distance, or `mirrormount camera scale`"
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
        camera = open_camera(args.camera or os.environ.get("MIRRORMOUNT_CAMERA", "0"))
        with contextlib.closing(camera):
            optics = _optics(args, camera, None)
            with Mount.open(args.port) as mount:
                yield mount, camera, optics
        return
    which = whole(args.camera or "1", "--camera with --virtual")
    if which not in (1, 2):
        raise BadValue(f"the virtual table has the cameras 1 and 2, not {which}")
    table = open_table(address)
    with contextlib.closing(table):
        camera = table.cameras[which - 1]
        sheet = _scale_of(camera, camera.sensor.pixel_mm, 0.0, (_NEAR_MM, _FAR_MM)[which - 1], 0.0, 45.0)
        optics = _optics(args, camera, sheet)
        with Mount(Link(table.ports[0])) as mount:
            yield mount, camera, optics


def _optics(args: argparse.Namespace, camera: Camera, otherwise: Scale | None) -> Optics:
    """The scale of the arguments, else `otherwise` (a virtual table's), else the camera's saved one."""
    if args.mm_per_px is None:
        for given, name in ((args.mm_per_px_error, "--mm-per-px-error"), (args.distance, "--distance")):
            if given is not None:
                raise BadValue(f"{name} needs --mm-per-px")
        if otherwise is None:
            with contextlib.suppress(NotCalibrated):
                otherwise = camera_scale.read(camera)
        return Optics(otherwise)
    mm_per_px, mm_error = _length(args.mm_per_px, args.mm_per_px_error, "--mm-per-px")
    distance, distance_error = (None, 0.0)
    if args.distance is not None:
        distance, distance_error = _length(args.distance, args.distance_error, "--distance")
    incidence = number(args.incidence, "--incidence")
    if not 0 <= incidence < 90:
        raise BadValue(f"--incidence is 0 … 90 degrees, not {args.incidence}")
    return Optics(_scale_of(camera, mm_per_px, mm_error, distance, distance_error, incidence))


def _scale_of(
    camera: Camera, mm: float, mm_error: float, distance: float | None, distance_error: float, incidence: float
) -> Scale:
    width, height = camera.size
    return Scale(width, height, mm, mm_error, distance, distance_error, incidence)


def _length(text: str, error: str | None, what: str) -> tuple[float, float]:
    value, spread = number(text, what), number(error, f"{what}-error") if error is not None else 0.0
    if value <= 0 or spread < 0:
        raise BadValue(f"{what} is more than 0, and its error not less")
    return value, spread


def _axes(text: str, mount: Mount) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    return tuple(mount.axis(name).name for name in names)


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


def _write(page: Path, numbers: Path, result: Result, origin: Origin, observer: Observer) -> None:
    last = (observer.last[0].image, observer.last[1]) if observer.last else None
    write_page(page, result, origin, last)
    write_json(numbers, result, origin)
    print(f"{'partial ' if result.partial else ''}report: {page}, numbers: {numbers}")


def _summarise(result: Result, optics: Optics) -> None:
    for name, estimate in result.estimates.items():
        other = optics.shown(estimate) if estimate.unit == "px" else estimate
        print(
            f"  {name:28} {estimate}"
            + (f"  = {other}{' of the beam' * (other.unit == 'urad')}" * (other is not estimate))
        )
    for remark in result.remarks:
        print(f"  {remark}")
