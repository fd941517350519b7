"""The end of a session that nobody refers to any more. Imports errors, keep_alive, lines, stoppable."""

import contextlib
import os
from collections.abc import Iterable

from mirrormount.common.errors import MountError
from mirrormount.device.keep_alive import KeepAlive
from mirrormount.transport.lines import Link
from mirrormount.transport.stoppable import Stoppable


def abandon(process: int, link: Link, keep_alive: KeepAlive, stoppables: Iterable[Stoppable]) -> None:
    """Stop the board and close its port, if this is the process that opened it.

    The collector of garbage calls this in any thread and at any time, so it waits for no lock.
    """
    if process != os.getpid():
        return
    keep_alive.end()
    with contextlib.suppress(MountError, OSError):  # it was closed, or the board has gone
        link.port.write(b"!\n")
    for stoppable in stoppables:
        stoppable.close()
    link.close()
