"""One owner of a mount, many clients. Knows no web; the panel, camera loops and control systems use it alike.

    with Supervisor("virtual://") as supervisor, supervisor.join("camera loop") as loop:
        loop.take_control()
        loop.step("x", 3).wait()

supervisor.py      opens a mount for programs of this process: start here
of_table.py        the supervisors of a table's mounts
program.py         a program as a client: control, beats, requests
motions.py         requests on the mount, and their outcomes
lease.py           which client has control, and which are alive          pure
requests.py        requests as data; those that arrive as JSON            pure
presses.py         direction buttons: down, up, waiting                   pure
pad.py             their steps and runs on the mount
worker.py          the one thread that uses the mount
tasks.py           its queue; questions to the mount
brake.py           the thread that stops it
reconnect.py       the board as it comes and goes
state.py           the last known state, for display
notices.py         the last events in words
wire_log.py        the last lines on the wire
scales.py          mrad a step
board_settings.py  the board's settings, cached for all clients (asyncio)
"""

from mirrormount.supervise.motions import Motion
from mirrormount.supervise.supervisor import Program, Supervisor

__all__ = ["Motion", "Program", "Supervisor"]
