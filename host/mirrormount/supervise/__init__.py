"""One owner of a mount, many clients. Knows no web; the panel, camera loops and control systems use it alike.

    with Supervisor("virtual://") as supervisor, supervisor.join("camera loop") as loop:
        loop.take_control()
        loop.step("x", 3).wait()

supervisor.py  opens a mount for programs of this process, and what such a program can ask: start here
lease.py       which client has control, and which are alive; pure
requests.py    requests as data, and those that arrive as JSON; pure
motions.py     requests on the mount, and their outcomes
worker.py      the one thread that uses the mount, the thread that stops it, and the direction buttons
connection.py  the board as it comes and goes, and its last known state with its scales
log.py         the last events in words, and the last lines on the wire
"""

from mirrormount.supervise.motions import Motion
from mirrormount.supervise.supervisor import Program, Supervisor

__all__ = ["Motion", "Program", "Supervisor"]
