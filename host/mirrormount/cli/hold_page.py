"""`mirrormount hold --page`: the loop's page, served by a thread beside the loop."""

import argparse
import contextlib
import threading
from collections.abc import Callable, Iterator

from mirrormount.beam.control.hold import Hold
from mirrormount.beam.control.interfaces import LoopTable
from mirrormount.cli import web_opening
from mirrormount.common.errors import NotInControl
from mirrormount.panel.hold_board import HoldBoard
from mirrormount.panel.hold_page import make_hold_server
from mirrormount.panel.log_file import log_to_file


class HoldPage:
    """board: takes the loop's events. hold: what HOLD tells to go on.

    halt(): stops all mounts from any thread, and ends the loop's control; None: only the loop itself can.
    """

    def __init__(self, table: LoopTable, halt: Callable[[], object] | None) -> None:
        self.board = HoldBoard({camera.name: camera.um_per_px for camera in table.cameras})
        self.hold: Hold | None = None
        self._halt = halt

    def go(self) -> None:
        """HOLD was pressed. Raises NotInControl."""
        if self.hold is None:
            raise NotInControl("nothing was done: the loop has not begun to hold the beam")
        self.hold.go_on()

    def stop(self) -> None:
        """STOP was pressed. Raises NotInControl."""
        if self._halt:
            self._halt()
        elif self.hold:
            self.hold.stop()
        else:
            raise NotInControl("this virtual table is stopped by Ctrl-C until it holds the beam")


@contextlib.contextmanager
def served(args: argparse.Namespace, table: LoopTable, halt: Callable[[], object] | None) -> Iterator[HoldPage]:
    """Serve the page of a loop on this table. Raises BadValue, BadAddress, CannotListen."""
    page = HoldPage(table, halt)
    with web_opening.opened(args) as opening, contextlib.ExitStack() as kept:
        log_to_file()
        server = make_hold_server(table.cameras, page.board, opening.sign_in, go=page.go, stop=page.stop)
        thread = threading.Thread(target=server.run, args=([opening.listener],), name="page", daemon=True)
        thread.start()
        opening.tell("the loop's page", "can stop the loop, and tell it to go on")
        if args.browser:
            opening.browser(kept)()
        try:
            yield page
        finally:
            server.should_exit = True
            thread.join(5)
