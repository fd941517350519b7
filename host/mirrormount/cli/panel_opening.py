"""The work of `mirrormount panel`: serves it, prints its addresses, opens the browser. Ctrl-C stops the motors."""

import argparse
import contextlib
import importlib.util
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

from mirrormount.cli import panel_camera, panel_mounts, web_opening
from mirrormount.cli.command import patience_of, virtual_address
from mirrormount.common.errors import BadValue, ExtraMissing, NoBoardFound
from mirrormount.common.extras import install
from mirrormount.device import table_file
from mirrormount.device.table_file import MountEntry
from mirrormount.supervise import Supervisor
from mirrormount.transport.find import find

if TYPE_CHECKING:
    from mirrormount.beam.live import LiveCamera
    from mirrormount.panel.camera_view import CameraView


def serve_panel(args: argparse.Namespace) -> None:
    """Serve the panel until told to end. Raises MountError."""
    if any(importlib.util.find_spec(name) is None for name in ("nicegui", "segno")):
        raise ExtraMissing(f"the panel needs NiceGUI, which is not installed: {install('gui')}")
    patience_s = patience_of(args)
    mounts = _mounts_of_table(args)
    address = None if mounts else _address(args)
    with web_opening.opened(args) as opening, contextlib.ExitStack() as opened:
        view = None
        if mounts:
            supervisors = panel_mounts.of_table(mounts, patience_s)
        elif args.mounts == "2":
            supervisors = opened.enter_context(panel_mounts.virtual(args, patience_s))
        else:
            board, view = opened.enter_context(panel_camera.opened(args, address))
            supervisors = {"": Supervisor(board, patience_s=patience_s)}
        _serve(supervisors, opening, args.browser, view)


def _mounts_of_table(args: argparse.Namespace) -> Mapping[str, MountEntry]:
    """The mounts of the table, where no port is named and no virtual board is asked for; one alone becomes args.at.

    Raises BadFile, BadValue.
    """
    if args.mounts and not args.virtual:
        raise BadValue("--mounts: of virtual boards; add --virtual")
    if args.mounts == "2" and args.camera is not None:
        raise BadValue("a click on a picture moves the spot by one mount: leave --mounts 2 or --camera out")
    mounts = {} if args.at or args.port or args.virtual else table_file.read().mounts
    if len(mounts) == 1:
        (args.at,) = mounts
        return {}
    if mounts and args.camera is not None:
        names = ", ".join(mounts)
        raise BadValue(f"a click on a picture moves the spot by one mount: name it (mirrormount panel NAME): {names}")
    return mounts


def _address(args: argparse.Namespace) -> str | None:
    """The board's address; a virtual one if that is asked for, or taken at a terminal where no board is found."""
    given = args.at or args.port
    virtual = virtual_address(args)
    if virtual:
        if args.at:
            raise BadValue("--virtual is a board of its own: leave the port out")
        return virtual
    if given is None and not find():
        if not _virtual_wanted():
            raise NoBoardFound(
                "no board found: plug one in, name its port, or take a virtual one: mirrormount panel --virtual"
            )
        return "virtual://"
    return given


def _virtual_wanted() -> bool:
    """Ask, if there is somebody to ask."""
    if sys.stdin is None or not sys.stdin.isatty():
        return False
    try:
        answer = input("No board found. Open the panel with a virtual one? [y/N] ")
    except EOFError:  # Ctrl-D
        return False
    return answer.strip().lower() in ("y", "yes")


def _serve(
    supervisors: Mapping[str, Supervisor],
    opening: web_opening.Opening,
    browser: bool,
    view: "CameraView[LiveCamera] | None",
) -> None:
    from mirrormount.panel.server import make_server

    web_opening.end_by_signals()
    with contextlib.ExitStack() as pages:
        panel_mounts.open_all(supervisors, pages)
        workers = {name: supervisor.worker for name, supervisor in supervisors.items()}
        phone = (lambda: opening.link(opening.addresses[0], opening.sign_in.new_code)) if opening.wide else None
        server = make_server(workers, opening.sign_in, phone, view)
        opening.tell(panel_mounts.told(workers), f"can drive the mount{'s' if len(workers) > 1 else ''}")
        if browser:
            server.when_ready(opening.browser(pages))
        server.run([opening.listener])
