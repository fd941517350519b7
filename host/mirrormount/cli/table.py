"""`mirrormount table`: names of mounts and cameras. No port is opened, and no camera."""

import argparse
import dataclasses
import importlib
import os
from collections.abc import Container

from mirrormount.cli.arguments import (
    PORT_VARIABLE,
    Command,
    camera_options,
    camera_settings,
    number,
    table_option,
    whole,
)
from mirrormount.device import calibration, table_file
from mirrormount.device.table_file import CameraEntry, MountEntry, TableFile
from mirrormount.errors import BadValue, NoBoardFound
from mirrormount.terminal import printable, without_credentials
from mirrormount.transport.discovery import find_one
from mirrormount.values import did_you_mean, paired


def arguments(parser: argparse.ArgumentParser) -> None:
    """The verb; without one the table is listed."""
    table_option(parser)
    verbs = parser.add_subparsers(dest="verb", metavar="VERB")
    verbs.add_parser("list", help="what is there, and what is missing (the default)")
    mount = verbs.add_parser("mount", help="give a mount a name, or change what is known of it")
    mount.add_argument("name", metavar="NAME")
    mount.add_argument("at", nargs="?", metavar="PORT", help="where it is now (default: the only board)")
    mount.add_argument("--x-axis", metavar="N", help="the board's axis that is x (2)")
    mount.add_argument("--distance", metavar="MM", help="along the beam, from the mirror before")
    camera = verbs.add_parser("camera", help="give a camera a name, or change what is known of it")
    camera.add_argument("name", metavar="NAME")
    camera.add_argument("camera", nargs="?", metavar="CAMERA", help="as --camera takes it: an index, a part of a name")
    camera.add_argument("--target", nargs=2, metavar=("X", "Y"), help="where the spot belongs, in pixels")
    camera.add_argument("--distance", metavar="MM", help="along the beam, from the last mirror")
    camera_options(camera)
    verbs.add_parser("remove", help="forget a name").add_argument("name", metavar="NAME")


def run(args: argparse.Namespace) -> int | None:
    """List, add or remove. Raises MountError."""
    verbs = {"list": list_names, "mount": name_mount, "camera": name_camera, "remove": remove_name}
    return verbs[args.verb or "list"](args)


# ---- the verbs


def list_names(_args: argparse.Namespace) -> int:
    """Print one line a name. Returns 1 if something is missing."""
    table = table_file.read()
    print(table_file.path())
    complete = True
    for name, entry in table.mounts.items():
        there, line = _mount_line(name, entry)
        complete &= there
        print(f"{name}: {line}")
    for name, entry in table.cameras.items():
        there, line = _camera_line(entry)
        complete &= there
        print(f"{name}: {line}")
    if not table.mounts and not table.cameras:
        print("no names yet: mirrormount table mount NAME, mirrormount table camera NAME CAMERA")
    return 0 if complete else 1


def name_mount(args: argparse.Namespace) -> None:
    """Add a mount, or change it. A board that USB shows is known by its id from now on, wherever it is plugged in."""
    name = table_file.check_name(args.name)
    x_axis = None if args.x_axis is None else whole(args.x_axis, "--x-axis")
    if x_axis is not None and not 1 <= x_axis <= 4:
        raise BadValue(f"--x-axis is the number of an axis, 1 to 4, not {x_axis}")
    distance_mm = _length(args.distance)
    table = table_file.read()
    _not_in(table.cameras, name, "camera")
    entry = table.mounts.get(name)
    if args.at is not None or entry is None:
        entry = dataclasses.replace(entry or MountEntry(), **_place(args.at))
    if x_axis is not None:
        entry = dataclasses.replace(entry, x_axis=x_axis)
    if distance_mm is not None:
        entry = dataclasses.replace(entry, distance_mm=distance_mm)
    for other, taken in table.mounts.items():
        same = (taken.board, taken.port) == (entry.board, entry.port)
        if other != name and same and _pair(taken.x_axis) == _pair(entry.x_axis):
            raise BadValue(f"{other} is that mount already: these axes of that board have one name")
    _write(dataclasses.replace(table, mounts={**table.mounts, name: entry}))
    print(f"{name}: {_mount_line(name, entry)[1]}")


def name_camera(args: argparse.Namespace) -> None:
    """Add a camera, or change it."""
    name = table_file.check_name(args.name)
    target = args.target and [number(text, "--target") for text in args.target]
    if target and min(target) < 0:
        raise BadValue("--target is a place in the picture: two numbers from 0, in pixels")
    distance_mm = _length(args.distance)
    settings = camera_settings(args)
    table = table_file.read()
    _not_in(table.mounts, name, "mount")
    entry = table.cameras.get(name)
    if entry is None and args.camera is None:
        raise BadValue(f"{name} is new: which camera? `mirrormount camera list` lists them")
    entry = entry or CameraEntry(args.camera)
    if args.camera is not None:
        if not args.camera.strip() or not args.camera.isprintable() or len(args.camera) > 200:
            raise BadValue("the camera is an index, a device, or a part of a webcam's name")
        entry = dataclasses.replace(entry, camera=args.camera)
    if target:
        entry = dataclasses.replace(entry, target_x_px=target[0], target_y_px=target[1])
    if distance_mm is not None:
        entry = dataclasses.replace(entry, distance_mm=distance_mm)
    entry = dataclasses.replace(entry, settings=settings.over(entry.settings))
    _write(dataclasses.replace(table, cameras={**table.cameras, name: entry}))
    print(f"{name}: {_camera_line(entry)[1]}")


def remove_name(args: argparse.Namespace) -> None:
    """Forget a name. What was measured of the mount is kept under its board's id."""
    table = table_file.read()
    if args.name not in table.mounts and args.name not in table.cameras:
        name, names = printable(args.name, 40), [*table.mounts, *table.cameras]
        raise BadValue(f"{name} is no name of {table_file.path()}{did_you_mean(name, names)}")
    mounts = {name: entry for name, entry in table.mounts.items() if name != args.name}
    cameras = {name: entry for name, entry in table.cameras.items() if name != args.name}
    _write(TableFile(mounts, cameras))


def _write(table: TableFile) -> None:
    print(f"written: {table_file.write(table)}")


def _mount_line(name: str, entry: MountEntry) -> tuple[bool, str]:
    """Whether the mount is there, and what is known of it."""
    pair = f"x is axis {entry.x_axis}"
    if entry.distance_mm is not None:
        pair += f", {entry.distance_mm:g} mm behind the mirror before"
    try:
        address = table_file.port_of_entry(name, entry).address
        there, where = True, printable(address)
        if entry.board is None and _is_path(address) and not os.path.exists(address):
            there, where = False, f"{where} NOT THERE"
    except NoBoardFound:
        there, where = False, "NOT PLUGGED IN"
    if entry.board is None:
        return there, f"{where}; {pair}"
    numbers = sorted({entry.x_axis, paired(entry.x_axis)})
    unknown = [f"axis {axis}" for axis in numbers if calibration.read(entry.board, axis) is None]
    scale = f"no scale of {', '.join(unknown)} yet (mirrormount setup)" if unknown else "scales measured"
    return there, f"{where}, board {printable(entry.board)}; {pair}; {scale}"


def _camera_line(entry: CameraEntry) -> tuple[bool, str]:
    """Whether the camera is there, and what is known of it."""
    there, where = _camera_is_there(entry.camera)
    target = entry.target_px
    known = "no target yet" if target is None else f"target {target[0]:g}, {target[1]:g} px"
    if entry.distance_mm is not None:
        known += f", {entry.distance_mm:g} mm behind the last mirror"
    if entry.settings.given:
        known += f"; {printable(str(entry.settings))}"
    return there, f"camera {printable(without_credentials(entry.camera))}{where}; {known}"


def _camera_is_there(address: str) -> tuple[bool, str]:
    """Whether the system lists the camera, and what is to be said of that."""
    if "://" in address or os.path.exists(address):
        return True, ""
    try:
        webcams = importlib.import_module("mirrormount_beam.webcams")  # by name: this package imports no other
    except ModuleNotFoundError:
        return True, " (not looked for: OpenCV is not installed)"
    devices = webcams.listed()
    if devices is None:
        return True, " (not looked for: this system has no list of cameras)"
    if any(address == str(device.number) or device.has_name(address) for device in devices):
        return True, ""
    return False, ": NOT PLUGGED IN"


def _place(address: str | None) -> dict[str, str | None]:
    """Board or port of an entry, from where the mount is now."""
    at = address or os.environ.get(PORT_VARIABLE) or find_one()
    ids = {device: board for board, device in table_file.plugged_boards().items()}
    if at in ids:
        return {"board": ids[at].lower(), "port": None}
    if not at.isprintable() or len(at) > 200:
        raise BadValue("a port's address is at most 200 printable characters")
    return {"board": None, "port": os.path.abspath(at) if _is_path(at) else at}  # commands run in other folders, too


def _is_path(address: str) -> bool:
    return os.sep in address and "://" not in address


def _not_in(names: Container[str], name: str, what: str) -> None:
    if name in names:
        raise BadValue(f"{name} is the name of a {what} already")


def _pair(x_axis: int) -> int:
    return (x_axis - 1) // 2


def _length(text: str | None) -> float | None:
    if text is None:
        return None
    value = number(text, "--distance")
    if value <= 0:
        raise BadValue(f"--distance is above 0 mm, not {text}")
    return value


COMMANDS = (Command("table", "name the mounts and cameras of an optical table; list what is there", run, arguments),)
