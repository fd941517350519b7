"""Opens virtual boards: what `virtual://` stands for, in this process and on every system.

virtual://                      in real time, as a real board would behave
virtual://?speed=max            in lockstep with the caller: fast, exact, the same every time
…&bench=paper|switches  &board=pico|pico_drv8833  &seed=N  &edges=FILE
"""

import socket
import threading
from pathlib import Path
from urllib.parse import parse_qsl

from mirrormount.errors import BadAddress, ConnectionLost, MountError
from mirrormount.link import SocketPort
from mirrormount.virtual import machines
from mirrormount.virtual.bench import Bench
from mirrormount.virtual.live import PairPort, serve
from mirrormount.virtual.stepped import Stepped
from mirrormount.virtual.world import BoardGone, World

BENCHES = ("paper", "switches")
BOARDS = {"pico": machines.PICO, "pico_drv8833": "pico_drv8833"}


def make_world(
    bench: str = "paper",
    board: str = "pico",
    seed: int = 1,
    edges: Path | None = None,
    firmware: Path | None = None,
) -> World:
    """A virtual board that has just been switched on. Raises BadAddress for a bench or board it has not."""
    if bench not in BENCHES:
        raise BadAddress(f"there is no bench {bench!r}: choose one of {', '.join(BENCHES)}")
    if board not in BOARDS:
        raise BadAddress(f"there is no virtual board {board!r}: choose one of {', '.join(BOARDS)}")
    try:
        file = edges.open("w", encoding="utf-8") if edges else None
    except OSError as e:
        raise BadAddress(f"cannot write pin edges to {edges}: {e.strerror}") from e
    optics = Bench(switches=bench == "switches", two_pwm=board == "pico_drv8833", seed=seed)
    return World(machines.cpython(BOARDS[board], firmware), optics, edges=file)


def open_virtual(url: str) -> "LivePort | SteppedPort":
    """A port (see mirrormount.link) on a new virtual board. Raises BadAddress for an option it has not."""
    options = dict(parse_qsl(url.removeprefix("virtual://").removeprefix("?"), keep_blank_values=True))
    speed = options.pop("speed", "1")
    known = {"bench", "board", "seed", "edges"}
    if speed not in ("1", "max") or set(options) - known or not options.get("seed", "1").isdecimal():
        raise BadAddress(f"{url}: options are speed=1|max, bench=, board=, seed=NUMBER, edges=FILE")
    world = make_world(
        options.get("bench", "paper"),
        options.get("board", "pico"),
        int(options.get("seed", "1")),
        Path(options["edges"]) if "edges" in options else None,
    )
    return SteppedPort(world) if speed == "max" else LivePort(world)


class LivePort(SocketPort):
    """A virtual board in a thread, in real time."""

    def __init__(self, world: World) -> None:
        ours, theirs = socket.socketpair()
        super().__init__(ours, "the virtual board")
        self.world = world
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._live, args=(PairPort(theirs),), name="virtual board", daemon=True)
        self._thread.start()

    def _live(self, port: PairPort) -> None:
        try:
            serve(self.world, [port], self._stopping.is_set)
        except (BoardGone, MountError):
            pass  # whoever talks to it sees that it has gone
        finally:
            port.close()

    def close(self) -> None:
        """Power off."""
        self._stopping.set()
        super().close()
        self._thread.join(5)
        self.world.close()


class SteppedPort:
    """A virtual board whose time passes only while somebody reads or sleeps."""

    lockstep = True

    def __init__(self, world: World) -> None:
        self.world = world
        self._stepped = Stepped(world)

    def monotonic(self) -> float:
        """Seconds of the board's time."""
        return self.world.now_us * 1e-6

    def sleep(self, seconds: float) -> None:
        """Let the board's time pass."""
        self._run(seconds, lambda: False)

    def read(self, timeout_s: float) -> bytes:
        """Bytes that are there, or come within timeout_s of the board's time; may be none."""
        received = self._stepped.received
        self._run(timeout_s, lambda: bool(received))
        data = bytes(received)
        received.clear()
        return data

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._stepped.send(data)

    def close(self) -> None:
        """Power off."""
        self.world.close()

    def _run(self, seconds: float, until) -> None:
        try:
            self._stepped.run(round(seconds * 1e6), until)
        except BoardGone as e:
            raise ConnectionLost("the virtual board is gone") from e
