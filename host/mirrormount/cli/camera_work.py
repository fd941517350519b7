"""The work of `mirrormount camera`."""

import argparse
import contextlib
import itertools
import sys
from collections.abc import Iterator

from mirrormount.beam import find_spot
from mirrormount.beam.camera import Camera, Frame
from mirrormount.beam.open_camera import open_camera
from mirrormount.beam.picture import GREY_OF_COLOUR, Dark
from mirrormount.beam.recording import read_picture
from mirrormount.beam.recording import record as write_recording
from mirrormount.beam.spot import NoSpot, Spot
from mirrormount.beam.webcam import listed, tried
from mirrormount.cli.command import from_extra, note, whole
from mirrormount.common.errors import BadValue
from mirrormount.common.printable import printable
from mirrormount.common.progress import StatusLine


def list(_args: argparse.Namespace) -> None:
    """Print one line a camera, and which ones are not looked for."""
    devices = listed()
    if devices is None:
        print("this system has no list of cameras: indices 0 to 5 are tried", file=sys.stderr)
        devices = tried()
    for device in devices:
        print(f"{device.number}  {printable(device.name)}")
    if not devices:
        print("no camera found; with --virtual none is needed")
    print("not looked for: cameras on the network, and those that need their maker's driver", file=sys.stderr)


def show(args: argparse.Namespace) -> None:
    """Print one line a frame, or serve a page. Raises ExtraMissing."""
    dark = Dark.of(read_picture(args.dark)) if args.dark else None
    if args.page:
        if args.frames is not None:
            raise BadValue("--frames is of the lines, and --page shows no lines")
        with from_extra("gui", "a page needs"):
            from mirrormount.cli import camera_page
        camera_page.serve(args, dark)
        return
    with _opened(args) as (camera, frames):
        print(f"{printable(camera.name)}, {camera.size} pixels; grey: {GREY_OF_COLOUR}", file=sys.stderr)
        for frame in frames:
            print(line(frame, find_spot(frame, dark)), flush=True)


def record(args: argparse.Namespace) -> None:
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


def line(frame: Frame, found: Spot | NoSpot) -> str:
    """What is known of a frame, in one line."""
    marks = (" repeated" if frame.repeated else "") + (" late" if frame.late else "")
    seen = f"{found.detection.threshold:.1f}" if found.detection else "none"
    if isinstance(found, NoSpot):
        return f"{frame.number:6d}  {found}  (threshold {seen}){marks}"
    also = f" saturated {found.saturated}" if found.saturated else ""
    also += f" ghost {found.ghost:.1%}" if found.ghost else ""
    return (
        f"{frame.number:6d}  x {found.x:8.3f} ± {found.sigma_x:.3f}  y {found.y:8.3f} ± {found.sigma_y:.3f} px"
        f"  width {found.width:.1f} x {found.height:.1f}  peak {found.peak:.0f}  threshold {seen}{also}{marks}"
    )


@contextlib.contextmanager
def _opened(args: argparse.Namespace) -> Iterator[tuple[Camera, Iterator[Frame]]]:
    """The camera, and as many frames as were asked for; Ctrl-C ends it in order."""
    most = whole(args.frames, "--frames") if args.frames is not None else None
    if most is not None and most < 1:
        raise BadValue(f"--frames is at least 1, not {most}")
    camera = open_camera(args.camera)
    try:
        _tell_controls(camera)
        yield camera, itertools.islice(camera.frames(), most)
    finally:
        camera.close()


def _tell_controls(camera: Camera) -> None:
    """Say which controls may change in mid-measurement."""
    for what, fixed in (("exposure", camera.controls.exposure_fixed), ("gain", camera.controls.gain_fixed)):
        if not fixed:
            state = "is automatic" if fixed is False else "may be automatic: the camera does not say"
            note(f"{what} {state}; fix it in the camera's own program")


class _Counted(Iterator[Frame]):
    """Frames; count: those before the one that was returned last, so they are written; all of them at the end."""

    def __init__(self, frames: Iterator[Frame], shown: StatusLine) -> None:
        self._frames, self._shown = frames, shown
        self._returned = self.count = 0

    def __next__(self) -> Frame:
        self.count = self._returned
        frame = next(self._frames)
        self._returned += 1
        self._shown.show(f"{self._returned} frames; Ctrl-C ends the recording")
        return frame
