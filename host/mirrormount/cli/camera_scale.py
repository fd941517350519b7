"""The work of `mirrormount camera scale`: mm per pixel, distance and incidence of a camera, in the user's file."""

import argparse
import contextlib
import itertools
from collections.abc import Callable
from dataclasses import replace

from mirrormount.beam import scale as scales
from mirrormount.beam.camera import Camera
from mirrormount.beam.estimate import Estimate
from mirrormount.beam.open_camera import open_camera
from mirrormount.beam.scale import Measured, Scale
from mirrormount.cli.command import note, number, positive, whole
from mirrormount.common.errors import BadValue
from mirrormount.common.printable import printable

_Find = Callable[[Camera], Measured]

_TRIES = 30  # frames in which a checkerboard is looked for: a webcam's first ones are dark
_CORNERS = (3, 30)  # inner corners along a side
_FARTHEST_MM = 100_000.0


def scale(args: argparse.Namespace) -> None:
    """Find and save a scale, or show the saved one. Raises MountError."""
    if args.source == "show":
        with contextlib.closing(open_camera(args.camera)) as camera:
            _tell(camera, scales.read(camera))
        return
    geometry, find = _geometry(args), _SOURCES[args.source](args)  # wrong input is told before a camera is opened
    with contextlib.closing(open_camera(args.camera)) as camera:
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
