"""The work of `mirrormount panel`: serves it, prints its addresses, opens the browser. Ctrl-C stops the motors."""

import argparse
import contextlib
import importlib.util
import sys
from typing import TYPE_CHECKING

from mirrormount.cli import panel_camera, web_opening
from mirrormount.cli.command import patience_of, virtual_address
from mirrormount.common.errors import BadValue, ExtraMissing, NoBoardFound
from mirrormount.common.extras import install
from mirrormount.transport.find import find

if TYPE_CHECKING:
    from mirrormount.beam.live import LiveCamera
    from mirrormount.panel.camera_view import CameraView
    from mirrormount.supervise.reconnect import Address


def serve_panel(args: argparse.Namespace) -> None:
    """Serve the panel until told to end. Raises MountError."""
    if any(importlib.util.find_spec(name) is None for name in ("nicegui", "segno")):
        raise ExtraMissing(f"the panel needs NiceGUI, which is not installed: {install('gui')}")
    patience_s = patience_of(args)
    address = _address(args)
    with web_opening.opened(args) as opening, panel_camera.opened(args, address) as (board, view):
        _serve(board, opening, patience_s, args.browser, view)


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
    board: "Address",
    opening: web_opening.Opening,
    patience_s: float,
    browser: bool,
    view: "CameraView[LiveCamera] | None",
) -> None:
    from mirrormount.panel.server import make_server
    from mirrormount.supervise import Supervisor

    web_opening.end_by_signals()
    with Supervisor(board, patience_s=patience_s) as supervisor, contextlib.ExitStack() as pages:
        worker = supervisor.worker
        phone = (lambda: opening.link(opening.addresses[0], opening.sign_in.new_code)) if opening.wide else None
        server = make_server(worker, opening.sign_in, phone, view)
        opening.tell(worker.mount.identity if worker.mount else "", "can drive the mount")
        if browser:
            server.when_ready(opening.browser(pages))
        server.run([opening.listener])
