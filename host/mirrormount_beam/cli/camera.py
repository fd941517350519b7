"""`mirrormount camera list | show | record | scale`.

`scale` saves the mm per pixel, the distance and the angle of incidence of a camera in the user's file of scales.
"""

import argparse
import contextlib
import csv
import io
import itertools
import json
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from mirrormount.cli.arguments import (
    Command,
    camera_options,
    camera_settings,
    note,
    number,
    page_of,
    positive,
    virtual_address,
    virtual_camera,
    virtual_options,
    web_options,
    whole,
)
from mirrormount.errors import BadValue, CannotWrite
from mirrormount.terminal import StatusLine, printable
from mirrormount_beam import genicam
from mirrormount_beam import scale as scales
from mirrormount_beam.camera import Camera, Image
from mirrormount_beam.cameras import open_camera
from mirrormount_beam.estimates import Estimate
from mirrormount_beam.exposure import advice
from mirrormount_beam.recordings import Folder, read_dark
from mirrormount_beam.recordings import record as write_recording
from mirrormount_beam.scale import Measured, Scale
from mirrormount_beam.spot.find import NoSpot, Spot, find_spot
from mirrormount_beam.webcams import listed, tried

# ---- list, show, record


def list_cameras(_args: argparse.Namespace) -> None:
    """Print one line a camera, and which ones are not looked for."""
    devices = listed()
    if devices is None:
        print("this system has no list of cameras: indices 0 to 5 are tried", file=sys.stderr)
        devices = tried()
    lines = [*map(str, devices), *(printable(f"{address}  {name}") for address, name in genicam.listed())]
    for line in lines:
        print(line)
    if not lines:
        print("no camera found; with --virtual none is needed")
    print(
        "not looked for: cameras of the network (http://…), and those that need their maker's program",
        file=sys.stderr,
    )


def show_spot(args: argparse.Namespace) -> None:
    """Print one line an image, or serve a page. Raises ExtraMissing."""
    dark = read_dark(args.dark) if args.dark else None
    if args.page:
        given = [name for name in ("frames", "json", "csv") if getattr(args, name) is not None]
        if given:
            raise BadValue(f"--{' and --'.join(given)}: of the lines, and --page shows no lines")
        page_of("camera")(args, dark)
        return
    if args.json and args.json == args.csv:
        raise BadValue(f"two files cannot both be {args.json}")
    with (
        _opened(args) as (camera, frames),
        _records(args.json, _json) as json_file,
        _records(args.csv, _csv) as csv_file,
    ):
        print(f"{printable(camera.name)}, {camera.size} pixels; {camera.selection}", file=sys.stderr)
        if csv_file:
            csv_file(dict(zip(RECORD, RECORD, strict=True)))
        told = ""
        for frame in frames:
            found = find_spot(frame, dark)
            print(line(frame, found), flush=True)
            for write in filter(None, (json_file, csv_file)):
                write(record(frame, found))
            advised = advice(frame, found)
            if advised and advised.kind != told:  # once, and not with each image
                told = advised.kind
                note(f"exposure: {advised.words}")


def record_images(args: argparse.Namespace) -> None:
    """Write a recording."""
    shown = StatusLine()
    with _opened(args) as (camera, frames):
        counted = _Counted(frames, shown)
        try:
            write_recording(camera, args.folder, counted)
        finally:
            shown.end()
            if counted.count:
                print(f"{counted.count} frames in {args.folder}")


def line(frame: Image, found: Spot | NoSpot) -> str:
    """What is known of an image, in one line."""
    marks = (" repeated" if frame.repeated else "") + (" late" if frame.late else "")
    marks += f"  {frame.colour.channel}" if frame.colour else ""
    marks += f"  {printable(frame.name)}" if frame.name else ""
    seen = f"{found.detection.threshold:.1f}" if found.detection else "none"
    if isinstance(found, NoSpot):
        return f"{frame.number:6d}  {found}  (threshold {seen}){marks}"
    also = f" saturated {found.saturated}" if found.saturated else ""
    return (
        f"{frame.number:6d}  x {found.x:8.3f} ± {found.sigma_x:.3f}  y {found.y:8.3f} ± {found.sigma_y:.3f} px"
        f"  shape {found.shape_px:.3f}  D4-sigma {found.d4_long:.1f} x {found.d4_short:.1f} at {found.angle:.0f}°"
        f"  peak {found.peak:.0f}  threshold {seen}{also}{marks}"
    )


_OF_SPOT = {  # columns of a record, and what they are of a Spot
    "x_px": "x",
    "y_px": "y",
    "sigma_x_px": "sigma_x",
    "sigma_y_px": "sigma_y",
    "d4_long_px": "d4_long",
    "d4_short_px": "d4_short",
    "angle_deg": "angle",
    "ellipticity": "ellipticity",
    "shape_px": "shape_px",
    "peak": "peak",
    "background": "background",
    "saturated_px": "saturated",
}
RECORD = ("number", "file", "time_s", *_OF_SPOT, "channel", "repeated", "late", "refusal", "refusal_text")


def record(frame: Image, found: Spot | NoSpot) -> dict[str, Any]:
    """What is known of an image, by RECORD; None is not known. refusal: the code of the reason for no spot."""
    about = {"number": frame.number, "file": frame.name or None, "time_s": round(frame.time_s, 6)}
    about |= {column: round(float(getattr(found, name)), 4) if found else None for column, name in _OF_SPOT.items()}
    about |= {"channel": frame.colour.channel if frame.colour else None}
    about |= {"repeated": frame.repeated, "late": frame.late}
    why = (found.reason.code, found.reason.words) if isinstance(found, NoSpot) else (None, None)
    return about | dict(zip(("refusal", "refusal_text"), why, strict=True))


def _json(one: dict[str, Any]) -> str:
    return json.dumps(one) + "\n"


def _csv(one: dict[str, Any]) -> str:
    text = io.StringIO()
    csv.writer(text).writerow([one[name] for name in RECORD])
    return text.getvalue()


@contextlib.contextmanager
def _records(
    path: Path | None, as_line: Callable[[dict[str, Any]], str]
) -> Iterator[Callable[[dict[str, Any]], None] | None]:
    """What writes a record as a line of a new file, at once. Raises CannotWrite."""
    if path is None:
        yield None
        return
    try:
        file = path.open("x", encoding="utf-8", newline="", buffering=1)
    except OSError as e:
        raise CannotWrite(f"{path}: {'exists; name a new file' if path.exists() else e.strerror}") from e

    def write(one: dict[str, Any]) -> None:
        try:
            file.write(as_line(one))
        except OSError as e:
            raise CannotWrite(f"{path}: {e.strerror}") from e

    with file:
        yield write


@contextlib.contextmanager
def _opened(args: argparse.Namespace) -> Iterator[tuple[Camera, Iterator[Image]]]:
    """The camera, and as many images as were asked for; Ctrl-C ends it in order."""
    most = whole(args.frames, "--frames") if args.frames is not None else None
    if most is not None and most < 1:
        raise BadValue(f"--frames is at least 1, not {most}")
    camera = open_camera(args.camera, settings=camera_settings(args))
    try:
        _tell_controls(camera)
        yield camera, itertools.islice(camera.frames(), most)
    finally:
        camera.close()


def _tell_controls(camera: Camera) -> None:
    """Say which controls may change in mid-measurement. Those of a file cannot."""
    if isinstance(camera, Folder):
        return
    for what, fixed in (("exposure", camera.controls.exposure_fixed), ("gain", camera.controls.gain_fixed)):
        if not fixed:
            state = "is automatic" if fixed is False else "may be automatic: the camera does not say"
            note(f"{what} {state}; fix it with --{what}, or in the camera's own program")


class _Counted(Iterator[Image]):
    """Images; count: those before the one that was returned last, so they are written; all of them at the end."""

    def __init__(self, frames: Iterator[Image], shown: StatusLine) -> None:
        self._frames, self._shown = frames, shown
        self._returned = self.count = 0

    def __next__(self) -> Image:
        self.count = self._returned
        frame = next(self._frames)
        self._returned += 1
        self._shown.show(f"{self._returned} frames; Ctrl-C ends the recording")
        return frame


# ---- scale

_Find = Callable[[Camera], Measured]

_TRIES = 30  # images in which a checkerboard is searched for: the first ones of a webcam are dark
_CORNERS = (3, 30)  # inner corners along a side
_FARTHEST_MM = 100_000.0


def save_scale(args: argparse.Namespace) -> None:
    """Find and save a scale, or show the saved one. Raises MountError."""
    if args.source == "show":
        with contextlib.closing(open_camera(args.camera, settings=camera_settings(args))) as camera:
            _tell(camera, scales.read(camera))
        return
    geometry, find = _geometry(args), _SOURCES[args.source](args)  # wrong input is told before a camera is opened
    with contextlib.closing(open_camera(args.camera, settings=camera_settings(args))) as camera:
        found = find(camera)
        saved = scales.read_if_any(camera, note)
        kept = saved or Scale(*camera.size, found.value, found.sigma)
        after = replace(kept, mm_per_px=found.value, sigma_mm_per_px=found.sigma, **geometry)
        path = scales.write(camera, after)
        _tell(camera, after)
        before = {"distance": saved and saved.distance_mm, "incidence": saved and saved.incidence_deg}
        same = [name for name, value in before.items() if value is not None and getattr(args, name) is None]
        if same:
            print(f"  {' and '.join(same)} as saved before")
        print(f"saved in {path}")


def _geometry(args: argparse.Namespace) -> dict[str, float]:
    """The fields of a Scale that were given beside mm a pixel. Raises BadValue."""
    given: dict[str, float] = {}
    distance, incidence = _optional(args, "distance"), _optional(args, "incidence")
    if distance:
        if not 0 < distance.value <= _FARTHEST_MM:
            raise BadValue(f"--distance is above 0 and at most {_FARTHEST_MM:g} mm, not {distance.value:g}")
        if not distance.sigma < distance.value:
            raise BadValue(f"--distance-error is less than --distance, not {distance.sigma:g}")
        given |= {"distance_mm": distance.value, "sigma_distance_mm": distance.sigma}
    if incidence:
        if not 0 <= incidence.value < 90:
            raise BadValue(f"--incidence is 0 to less than 90 degrees, not {incidence.value:g}")
        given |= {"incidence_deg": incidence.value, "sigma_incidence_deg": incidence.sigma}
    return given


def _optional(args: argparse.Namespace, name: str) -> Measured | None:
    """An option and its error. Raises BadValue."""
    value, error = getattr(args, name), getattr(args, f"{name}_error")
    if value is None:
        if error is not None:
            raise BadValue(f"--{name}-error needs --{name}")
        return None
    return Measured(number(value, f"--{name}"), _error(error, f"--{name}-error"))


def _error(text: str | None, what: str) -> float:
    sigma = number(text, what) if text is not None else 0.0
    if sigma < 0:
        raise BadValue(f"{what} is 0 or more, not {text}")
    return sigma


def _length(args: argparse.Namespace, text: str, what: str) -> Measured:
    length = Measured(positive(text, what), _error(args.error, "--error"))
    if not length.sigma < length.value:
        raise BadValue(f"--error is less than {what}, not {args.error}")
    return length


def _ruler(args: argparse.Namespace) -> _Find:
    start = number(args.x1, "X1"), number(args.y1, "Y1")
    end = number(args.x2, "X2"), number(args.y2, "Y2")
    length = _length(args, args.length, "MM")

    def find(camera: Camera) -> Measured:
        for x, y in (start, end):
            if not (0 <= x <= camera.size.width - 1 and 0 <= y <= camera.size.height - 1):
                raise BadValue(f"the point {x:g}, {y:g} is not in the picture of {camera.size} pixels")
        return scales.of_ruler(start, end, length)

    return find


def _checkerboard(args: argparse.Namespace) -> _Find:
    corners = whole(args.columns, "COLUMNS"), whole(args.rows, "ROWS")
    low, high = _CORNERS
    if not all(low <= count <= high for count in corners):
        raise BadValue(f"COLUMNS and ROWS count inner corners, {low} … {high}, not {corners[0]} and {corners[1]}")
    square = _length(args, args.square, "MM")

    def find(camera: Camera) -> Measured:
        why: BadValue | None = None
        for frame in itertools.islice(camera.frames(), _TRIES):
            try:
                return scales.of_checkerboard(frame.image, square, corners)
            except BadValue as e:
                why = e
        raise why or BadValue("the camera gave no picture")

    return find


def _pitch(args: argparse.Namespace) -> _Find:
    pitch = scales.of_pitch(_length(args, args.pitch, "UM"))
    return lambda _camera: pitch


def _geometry_only(args: argparse.Namespace) -> _Find:
    if args.distance is None and args.incidence is None:
        raise BadValue("give --distance or --incidence, or both")

    def find(camera: Camera) -> Measured:
        saved = scales.read(camera)
        return Measured(saved.mm_per_px, saved.sigma_mm_per_px)

    return find


def _tell(camera: Camera, scale: Scale) -> None:
    """What the scale means, in lines. Of the mirror: where the spot moves in the plane of incidence."""
    one, mm = Measured(1.0, 0.0), Measured(scale.mm_per_px, scale.sigma_mm_per_px)
    print(f"{printable(camera.name)}, {camera.size} pixels")
    print(f"  1 pixel                  {_words(mm, 'mm on the screen')}")
    if scale.distance_mm is None:
        print("  distance                 not known: angles need --distance")
        return
    print(f"  distance to the mirror   {_words(Measured(scale.distance_mm, scale.sigma_distance_mm), 'mm')}")
    if scale.incidence_deg is None:
        print("  angle of incidence       not known: across its plane, angles of the mirror need --incidence")
    else:
        incidence = Measured(scale.incidence_deg, scale.sigma_incidence_deg)
        print(f"  angle of incidence       {_words(incidence, 'degrees')}")
    beam, mirror = scale.beam_mrad(one), scale.mirror_mrad(one, in_plane=True)
    print(f"  1 pixel, of the beam     {_words(_micro(beam), 'urad')}")
    print(f"  1 pixel, of the mirror   {_words(_micro(mirror), 'urad')} in the plane of incidence")


def _micro(mrad: Measured) -> Measured:
    return Measured(mrad.value * 1000, mrad.sigma * 1000)


def _words(measured: Measured, unit: str) -> str:
    return str(Estimate(measured.value, measured.sigma, unit))


_SOURCES = {"ruler": _ruler, "checkerboard": _checkerboard, "pitch": _pitch, "geometry": _geometry_only}


# ---- the command


def arguments(parser: argparse.ArgumentParser) -> None:
    """The verb, and which camera."""
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    verbs.add_parser("list", help="the cameras of this computer")
    show = verbs.add_parser("show", help="where the spot is in each frame, or why there is none, until Ctrl-C")
    _camera(show)
    show.add_argument("--dark", type=Path, metavar="FILE", help="a picture without the beam, for the hot pixels")
    show.add_argument("--json", type=Path, metavar="FILE", help="a new file with a line of JSON for each frame")
    show.add_argument("--csv", type=Path, metavar="FILE", help="a new file with a row for each frame")
    show.add_argument("--page", action="store_true", help="show it on a page in the browser")
    web_options(show)
    record = verbs.add_parser("record", help="write frames into a new folder, lossless, with their times")
    record.add_argument("folder", type=Path, metavar="FOLDER")
    _camera(record)
    for each in (show, record):
        each.add_argument("--frames", metavar="N", help="end after so many")
    _scale(verbs.add_parser("scale", help="mm per pixel, distance and angle of incidence of a camera, saved for later"))


def _scale(parser: argparse.ArgumentParser) -> None:
    """From what the scale comes; each source has its numbers, and all have what follows."""
    sources = parser.add_subparsers(dest="source", required=True, metavar="SOURCE")
    ruler = sources.add_parser("ruler", help="two points in the picture, and the mm between them")
    for name in ("x1", "y1", "x2", "y2"):
        ruler.add_argument(name, metavar=name.upper(), help="pixels from the top left")
    ruler.add_argument("length", metavar="MM", help="from the first point to the second one")
    board = sources.add_parser("checkerboard", help="a printed checkerboard in the picture")
    board.add_argument("columns", metavar="COLUMNS", help="inner corners along a row: squares less one")
    board.add_argument("rows", metavar="ROWS", help="rows of inner corners")
    board.add_argument("square", metavar="MM", help="side of a square")
    pitch = sources.add_parser("pitch", help="a sensor without a lens: distance of its pixels")
    pitch.add_argument("pitch", metavar="UM", help="um, from the sensor's data sheet")
    geometry = sources.add_parser("geometry", help="only the distance or the angle of incidence; mm per pixel stays")
    _camera(sources.add_parser("show", help="the saved scale"))
    for source in (ruler, board, pitch):
        source.add_argument("--error", metavar="E", help="standard error of the length, in its unit (0)")
    for source in (ruler, board, pitch, geometry):
        _camera(source)
        source.add_argument("--distance", metavar="MM", help="from the mirror to the screen, along the beam")
        source.add_argument("--distance-error", metavar="MM", help="its standard error (0)")
        source.add_argument(
            "--incidence",
            metavar="DEGREES",
            help="between beam and mirror's normal (default: as saved before, else not known)",
        )
        source.add_argument("--incidence-error", metavar="DEGREES", help="its standard error (0)")


def _camera(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--camera",
        help="index, device, part of a name, http://…, folder, file with pictures, video, or virtual-table://"
        " (default: $MIRRORMOUNT_CAMERA, else 0); with --virtual: 1 or 2",
    )
    camera_options(parser)
    virtual_options(parser, "a camera of the virtual table of `measure` and `scan`; no hardware needed")


def run(args: argparse.Namespace) -> None:
    """List, show, record, or save a scale. Raises MountError."""
    if args.verb != "list":
        args.camera = _address(args)
    verbs = {"list": list_cameras, "show": show_spot, "record": record_images, "scale": save_scale}
    verbs[args.verb](args)


def _address(args: argparse.Namespace) -> str:
    """The address of the camera. Raises BadValue."""
    table = virtual_address(args, "virtual-table", mounts="1", cameras="2")
    if table is None:
        return os.environ.get("MIRRORMOUNT_CAMERA", "0") if args.camera is None else args.camera
    return f"{table}#{virtual_camera(args.camera)}"


COMMANDS = (Command("camera", "list cameras, show the spot, record frames, save a scale", run, arguments),)
