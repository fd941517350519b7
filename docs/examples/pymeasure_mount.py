"""A mirror mount as an instrument of pymeasure, over its USB port. Needs pymeasure, and nothing of mirrormount.

with MirrorMount("/dev/ttyACM0") as mount:
    mount.x.step(5)
    print(mount.x.position)

The lines that it sends are those of docs/protocol.md.
"""

import time

from pymeasure.adapters import SerialAdapter
from pymeasure.instruments import Channel, Instrument

_DONE = 1  # reason of a move that has ended by itself (docs/errors.md)


class Axis(Channel):
    """One axis. Positions are whole steps."""

    position = Channel.measurement("{ch}TP?", "Where it is.", cast=int)
    moving = Channel.measurement("{ch}MD?", "Does it move?", cast=int, get_process=lambda done: done == 0)
    ended = Channel.measurement("{ch}XE?", "How the last motion ended: reason, steps, microseconds.", separator=",")

    def step(self, n: int) -> None:
        """Move by n steps. If this program ends meanwhile, the board stops after 0.5 s. Raises RuntimeError."""
        self._move(f"PR{n}")

    def move_to(self, position: int) -> None:
        """Move to a position. As step()."""
        self._move(f"PA{position}")

    def _move(self, command: str) -> None:
        self.write("XK500;{ch}" + command)
        while self.moving:  # each question keeps it alive
            time.sleep(0.05)
        error = self.parent.error
        if self.ended[0] != _DONE or error[0]:
            raise RuntimeError(f"the move ended early, reason {self.ended[0]:g}: {error[1]}")


class MirrorMount(Instrument):
    """The mount at a serial port, with the axes x and y."""

    x = Instrument.ChannelCreator(Axis, 2)
    y = Instrument.ChannelCreator(Axis, 1)
    identity = Instrument.measurement("*IDN?", "Maker, board, its unique id, version.", cast=str)
    error = Instrument.measurement("TB?", "The oldest error, removed by this: number, text.", separator=", ")

    def __init__(self, port: str) -> None:
        adapter = SerialAdapter(port, baudrate=115200, timeout=2, write_termination="\n", read_termination="\r\n")
        super().__init__(adapter, "mirror mount", includeSCPI=False)

    def stop(self) -> None:
        """All motors off, now."""
        self.write("!")

    def __enter__(self) -> "MirrorMount":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self.adapter.close()
