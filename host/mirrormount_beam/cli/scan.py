"""`mirrormount scan raster | spiral | line | find`: mount, camera, pattern, files.

However a scan ends, the motors are off and the rows that were measured are kept.
"""

import argparse
import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from mirrormount.cli.arguments import (
    Command,
    camera_settings,
    mount_and_camera,
    note,
    virtual_address,
    virtual_camera,
    whole,
)
from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue, CannotWrite
from mirrormount.terminal import ended_in_order
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_table
from mirrormount_beam import scale as scales
from mirrormount_beam import scan as scan_module
from mirrormount_beam.camera import Camera
from mirrormount_beam.cameras import open_beside_mount, select
from mirrormount_beam.progress import ScanLine
from mirrormount_beam.scale import Scale
from mirrormount_beam.scan import (
    COMPLETE,
    CsvFile,
    Hdf5File,
    Metadata,
    Pattern,
    Sample,
    ScanPage,
    Signal,
    check_hdf5,
    grey_signal,
    metadata,
    of_camera,
    scan,
    spot_signal,
)

_FOUND = "found"


def run(args: argparse.Namespace) -> int:
    """Scan; the exit status: 1 if a search found nothing. Raises MountError."""
    pattern = _pattern(args)
    searches = args.verb == "find"
    files = [path for path in (args.csv, args.hdf5, args.page) if path]
    if len(set(files)) < len(files):
        raise BadValue(f"two files cannot both be {max(files, key=files.count)}")
    if args.hdf5:
        check_hdf5(args.hdf5)
    with ended_in_order(), _opened(args) as (mount, camera, scale):
        name = "spot" if searches else args.signal
        signal = spot_signal(camera) if name == "spot" else grey_signal(camera)
        about = metadata(mount, pattern, signal, read=name, **of_camera(camera, scale))
        with _kept(args, about, pattern, signal) as kept, mount.unless_stopped(since_open=True):
            keeps = bool(args.csv or args.hdf5)
            if not (keeps or searches):
                print("nothing is kept: --csv FILE or --hdf5 FILE writes place and value of each", flush=True)
            samples = scan(mount, pattern, signal, back=searches or args.back)
            with contextlib.closing(samples), ScanLine(pattern, keeps=keeps) as show:
                for sample in samples:
                    kept.add(sample)
                    show(sample)
                    if searches and sample.values:
                        kept.ended = _FOUND
                        break
    return _tell(args, pattern, kept)


class _Kept:
    """What was measured, and the CSV file and the page that get it at once."""

    def __init__(self, file: CsvFile | None, live: ScanPage | None) -> None:
        self.samples: list[Sample] = []
        self.ended = COMPLETE
        self._file, self._live = file, live

    def add(self, sample: Sample) -> None:
        """Keep a sample. Raises CannotWrite."""
        self.samples.append(sample)
        if self._file:
            self._file.add(sample)
        if self._live:
            self._live.add(sample)

    def end(self) -> None:
        """Close the file, and write the last page. Raises CannotWrite."""
        if self._file:
            self._file.end(self.ended)
        if self._live:
            self._live.end(self.ended)


def _begun(csv: Path | None, page: Path | None, about: Metadata, pattern: Pattern, signal: Signal) -> _Kept:
    """The files are begun. The page last: one of before stays if the scan does not begin. Raises CannotWrite."""
    file = CsvFile(csv, about, signal) if csv else None
    try:
        return _Kept(file, ScanPage(page, pattern, signal) if page else None)
    except CannotWrite as e:
        if file:
            file.end(str(e))
        raise


@contextlib.contextmanager
def _kept(args: argparse.Namespace, about: Metadata, pattern: Pattern, signal: Signal) -> Iterator[_Kept]:
    """The files, which are ended with the reason whatever happens."""
    csv, hdf5 = args.csv, args.hdf5
    whole = Hdf5File(hdf5, about, signal, pattern.measured) if hdf5 else None
    try:
        kept = _begun(csv, args.page, about, pattern, signal)
    except BaseException:
        if whole:
            whole.drop()
        raise
    try:
        try:
            yield kept
        except BaseException as e:
            kept.ended = "stopped by Ctrl-C" if isinstance(e, KeyboardInterrupt) else str(e) or type(e).__name__
            raise
    finally:
        try:
            kept.end()
        finally:
            if whole:
                whole.end(kept.samples, kept.ended)
            if kept.ended not in (COMPLETE, _FOUND):
                files = " and ".join(str(path) for path in (csv, hdf5) if path)
                print(f"{len(kept.samples)} places were measured" + (f": {files}" if files else ""))


def _pattern(args: argparse.Namespace) -> Pattern:
    """The pattern that the arguments name. Raises BadValue."""
    if args.verb == "line":
        return scan_module.line(whole(args.by_x, "BY_X"), whole(args.by_y, "BY_Y"), whole(args.count, "COUNT"))
    pitch = whole(args.pitch, "--pitch")
    if args.verb != "raster":
        return scan_module.spiral(whole(args.rings, "RINGS"), pitch)
    if args.serpentine and args.approach is not None:
        raise BadValue("--approach is of rows that all run to the right: leave it out, or --serpentine")
    approach = scan_module.APPROACH if args.approach is None else whole(args.approach, "--approach")
    columns, rows = whole(args.columns, "COLUMNS"), whole(args.rows, "ROWS")
    return scan_module.raster(columns, rows, pitch, serpentine=args.serpentine, approach=approach)


@contextlib.contextmanager
def _opened(args: argparse.Namespace) -> Iterator[tuple[Mount, Camera, Scale | None]]:
    """The mount, the camera that the arguments name and its scale; closed at the end."""
    address, settings = virtual_address(args, "virtual-table", mounts="1", cameras="2"), camera_settings(args)
    if address is None:
        camera = open_beside_mount(args.camera or os.environ.get("MIRRORMOUNT_CAMERA", "0"), settings)
        with contextlib.closing(camera), Mount.open(args.port) as mount:
            yield mount, camera, scales.read_if_any(camera, note)
        return
    which = virtual_camera(args.camera)
    with contextlib.closing(open_table(address)) as table, Mount(Link(table.ports[0])) as mount:
        camera = table.cameras[which - 1]
        select(camera, settings)
        yield mount, camera, camera.scale


def _tell(args: argparse.Namespace, pattern: Pattern, kept: _Kept) -> int:
    """Print the result in words; the exit status."""
    last = kept.samples[-1]
    if kept.ended == _FOUND:
        print(f"found at x {last.x:+d}, y {last.y:+d} steps from the start, at place {len(kept.samples)}")
        return 0
    if args.verb == "find":
        print(f"not found at any of {pattern.measured} places; the mount is at the start again")
        return 1
    without = sum(not sample.values for sample in kept.samples)
    n = len(kept.samples)
    print(f"{n} place{'s' * (n != 1)}" + (f", {without} of them without a value" if without else ""))
    for path in (args.csv, args.hdf5, args.page):
        if path:
            print(path)
    return 0


# ---- the command

SIGNALS = ("spot", "grey")


def arguments(parser: argparse.ArgumentParser) -> None:
    """The pattern; mount, camera and signal; the files."""
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="PATTERN")
    raster = verbs.add_parser("raster", help="rows about the start, each run to the right, from the lowest up")
    raster.add_argument("columns", metavar="COLUMNS")
    raster.add_argument("rows", metavar="ROWS")
    raster.add_argument("--serpentine", action="store_true", help="run every second row to the left")
    raster.add_argument("--approach", metavar="N", help="steps that a row begins beyond its first place (4)")
    spiral = verbs.add_parser("spiral", help="a square spiral from the start outwards")
    spiral.add_argument("rings", metavar="RINGS", help="how many turns around the start")
    line = verbs.add_parser("line", help="places in a line from the start on")
    line.add_argument("by_x", metavar="BY_X", help="steps of x from a place to the next")
    line.add_argument("by_y", metavar="BY_Y", help="the same of y")
    line.add_argument("count", metavar="COUNT", help="how many places")
    find = verbs.add_parser("find", help="a spiral that ends where the camera sees the beam")
    find.add_argument("rings", metavar="RINGS", nargs="?", default="10", help="how far it searches (10)")
    for verb in (raster, spiral, find):
        verb.add_argument("--pitch", metavar="N", default="1", help="steps between places (1)")
    for verb in (raster, spiral, line):
        verb.add_argument(
            "--signal", choices=SIGNALS, default="spot", help="the spot (default), or the mean grey value"
        )
        verb.add_argument("--back", action="store_true", help="return to the start at the end")
    for verb in (raster, spiral, line, find):
        _common(verb)


def _common(parser: argparse.ArgumentParser) -> None:
    mount_and_camera(parser)
    parser.add_argument("--page", type=Path, metavar="FILE", help="a live picture: open this HTML file in a browser")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="a new file, written row by row")
    parser.add_argument("--hdf5", type=Path, metavar="FILE", help="a new file, written at the end")


COMMANDS = (Command("scan", "visit places with the mount and read a camera at each; find a lost beam", run, arguments),)
