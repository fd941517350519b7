"""`mirrormount camera show --page`: the page of one camera, without a mount."""

import argparse
import contextlib
from typing import TYPE_CHECKING

from mirrormount.beam.checked import Limits
from mirrormount.beam.live import LiveCamera
from mirrormount.beam.open_camera import open_camera
from mirrormount.cli import web_opening
from mirrormount.cli.panel_camera import in_real_time
from mirrormount.common.printable import printable
from mirrormount.panel.camera_html import html
from mirrormount.panel.camera_view import CameraView
from mirrormount.panel.light_server import make_light_server, page
from mirrormount.panel.log_file import log_to_file

if TYPE_CHECKING:
    from mirrormount.beam.picture import Dark

_BODY = """<main class="one"><section class="card">{}</section><section class="card"><p class="hint">
Green: the spot, and twice its size (standard deviation). Grey: what is above the threshold. Red: the trail.
Below the picture: the grey values of the row through the spot, or through the brightest place, and what they have to
exceed. The errors are standard errors.</p></section></main>"""


def serve(args: argparse.Namespace, dark: "Dark | None") -> None:
    """Serve the page until a signal ends it. Raises MountError."""
    name: str = in_real_time(args.camera)
    live = LiveCamera(name, lambda: open_camera(name, limits=Limits(may_be_black=True)), dark)
    with web_opening.opened(args) as opening, contextlib.closing(live), contextlib.ExitStack() as kept:
        live.open()
        web_opening.end_by_signals()
        log_to_file()
        title = printable(live.name)
        body = _BODY.format(html(1, title, profile=True))
        server = make_light_server(page(title, body, "camera.js"), [CameraView(live)], opening.sign_in)
        opening.tell(title, "can see this camera")
        if args.browser:
            opening.browser(kept)()
        server.run([opening.listener])
