"""`mirrormount panel ...` with a camera loop as a further client of its mount. A line of stdin is an act of the loop.

ask: asks for control; take: takes it; jog: runs x; outcome: waits for the end of its last act, in words; hang: the
web server's loop does not turn any more, and the camera loop lives on.
Each act prints one line.
"""

import sys
import threading
import time

from mirrormount.cli import main
from mirrormount.errors import MountError
from mirrormount.supervise.supervisor import Program, Supervisor
from mirrormount_panel import cli, server

hanging = threading.Event()
turn = server.Server.on_tick


async def on_tick(self: server.Server, counter: int) -> bool:
    """A turn of the web server's loop."""
    if hanging.is_set():
        time.sleep(1000)
    return await turn(self, counter)


def act(loop: Program) -> None:
    """Carry out the lines of stdin."""
    pending = None
    for line in sys.stdin:
        try:
            match line.strip():
                case "ask":
                    pending = loop.ask_for_control()
                case "take":
                    loop.take_control()
                case "jog":
                    pending = loop.jog("x", 0.5).future
                case "hang":
                    hanging.set()
                    while not pending.done():
                        loop.beat()
                        time.sleep(0.05)
                case "outcome":
                    pending.result()
            print("done", flush=True)
        except MountError as e:
            print(e, flush=True)


class SupervisorWithLoop(Supervisor):
    """A Supervisor that a camera loop has joined."""

    def open(self, *, absent: bool = False) -> "SupervisorWithLoop":
        super().open(absent=absent)
        threading.Thread(target=act, args=(self.join("camera loop"),), daemon=True).start()
        return self


if __name__ == "__main__":
    cli.Supervisor = SupervisorWithLoop
    server.Server.on_tick = on_tick
    sys.exit(main.main(["panel", *sys.argv[1:], "--patience", "2"]))
