"""Hours of enemies and bad luck for boards, programs, a panel and `serve`: is a stop ever lost, a motor left on?

    .venv/bin/python tools/bench/endurance.py --minutes 120 --seed 1 --json FILE

Every station has a virtual board in a process of its own (`mirrormount virtual --edges`), an owner of its port (a
panel, a `serve`, a Supervisor, a Mount), and a thread here that moves the motors and then lets something happen: a
stop in one of four ways, a program killed or frozen, a page that falls silent, a board killed and back under another
number, all of it also in a crowd of half-open connections.

What must not be (a violation): an enable on later than 0.3 s after a stop that was told as done; an enable on later
than 0.6 s after its program died or froze (the board's keep-alive is 0.5 s); a motor that starts unasked, as when a
frozen program goes on or a board is back; a stop told as done where no board is; memory, files or threads of the panel
or of `serve` that grow from the second quarter to the last.

The times are the board's own. A moment here becomes a board's time by the times at which the last edges were written;
the smallest such difference of a minute decides, so that a busy computer, on which a virtual board's time runs slower,
is no fault of the product. With that of the last seconds alone a violation is called doubtful.

Each event is one JSON line, the summary is the last one. Exit status 1 after a violation.
"""

import argparse
import contextlib
import http.client
import itertools
import json
import os
import pty
import random
import re
import resource
import select
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

STOP_S = 0.3  # most, after a stop that was told as done
DEATH_S = 0.6  # most, after a program has died, or hangs
SEEN_S = 1.0  # what is seen to be off for so long, which is two steps, stays off
PATIENCE_S = 20.0  # for what may take long on a busy computer; never a measurement
PORTS_HELD = 6  # pseudo-terminals that take the number of a board that was killed
CROWDS = {"panel": (60, 250, 1100), "serve": (10, 60, 400)}
HALVES = (b"", b"GET / HT", b"POST /stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\nhalf")
MIRRORMOUNT = [sys.executable, "-P", "-m", "mirrormount"]


class Log:
    """Events as JSON lines, and what the summary is made of. Any thread."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8")
        self._lock = threading.Lock()
        self._start_s = time.monotonic()
        self.counts: Counter[str] = Counter()
        self.late_s: dict[str, list[float]] = defaultdict(list)
        self.found: dict[str, list[dict[str, Any]]] = {"violation": [], "doubtful": [], "refused": [], "harness": []}

    def event(self, station: str, what: str, **more: object) -> None:
        """One line."""
        at_s = round(time.monotonic() - self._start_s, 3)
        line: dict[str, Any] = {"at_s": at_s, "station": station, "event": what, **more}
        with self._lock:
            self.counts[f"{station}: {what}"] += 1
            for kind in self.found.keys() & more.keys():
                self.found[kind].append(line)
                print(json.dumps(line), flush=True)
            self._file.write(json.dumps(line) + "\n")
            self._file.flush()

    def close(self, summary: dict[str, object]) -> None:
        """The summary is the last line."""
        self._file.write(json.dumps(summary) + "\n")
        self._file.close()


# ---- a board


class Board:
    """A virtual board's process, its link, and the edges that it has written."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self._folder, self._runs = folder, itertools.count()
        self.link = folder / "mount"
        self._held: list[int] = []
        self.start()

    def start(self) -> None:
        """Power it up; the number of its terminal is another one than before."""
        self.link.unlink(missing_ok=True)  # of a board that was killed
        for fd in self._held:
            os.close(fd)
        self._held = [fd for _ in range(PORTS_HELD) for fd in pty.openpty()]
        file = self._folder / f"edges{next(self._runs)}.jsonl"
        self.process = started(["virtual", "--link", str(self.link), "--edges", str(file)], self._folder / "board.log")
        self._file = file.open("rb")
        self._rest = b""
        self._on: dict[str, bool] = {}
        self._drives: list[tuple[int, bool]] = []  # when an enable went on (True) or off, since the last look at them
        self._behind: list[tuple[float, float]] = []  # when an edge was written, and the wall's clock less the board's

    def kill(self) -> None:
        """Pull the plug."""
        self.process.kill()
        self.process.wait()
        self._file.close()

    def poll(self) -> None:
        """Read the edges that are there."""
        data = self._rest + self._file.read()
        whole, _, self._rest = data.rpartition(b"\n")
        edges = [json.loads(line) for line in whole.splitlines()]
        at = os.fstat(self._file.fileno())
        if edges and not self._rest and at.st_size == self._file.tell():
            self._behind.append((at.st_mtime, at.st_mtime - edges[-1]["t_us"] * 1e-6))
        for edge in edges:
            if edge["pin"].endswith("_en"):
                self._on[edge["pin"]] = edge["duty"] > 0
                self._drives.append((edge["t_us"], edge["duty"] > 0))

    @property
    def driving(self) -> bool:
        """True if a motor has drive now."""
        self.poll()
        return any(self._on.values())

    def forget(self) -> None:
        """Look at no earlier edge again."""
        self.poll()
        self._drives = []

    def drives(self) -> bool:
        """True if a motor has got drive since forget()."""
        self.poll()
        return any(on for _, on in self._drives)

    def late_s(self, wall_s: float, within_s: float) -> float:
        """How long after that moment a motor had drive for the last time; negative: before it.

        within_s: the board's time is taken from edges of so many seconds before.
        """
        self.poll()
        behind = [b for at_s, b in self._behind if at_s > wall_s - within_s] or [b for _, b in self._behind[-1:]]
        if not behind or not self._drives:
            return -1.0
        moment_us = (wall_s - min(behind)) * 1e6
        last_us = self._drives[-1][0]
        return (last_us - moment_us) * 1e-6

    def rest(self) -> bool:
        """Wait until no motor has had drive for SEEN_S. False if that does not come."""
        end_s, off_s = time.monotonic() + PATIENCE_S, None
        while time.monotonic() < end_s:
            if self.driving:
                off_s = None
            elif off_s is None:
                off_s = time.monotonic()
            elif time.monotonic() - off_s > SEEN_S:
                return True
            time.sleep(0.01)
        return False


def started(words: list[str], log: Path, most_files: int = 0) -> subprocess.Popen:
    """A `mirrormount` that is ready. Raises RuntimeError if it ends instead."""
    limit = ["prlimit", f"--nofile={most_files}"] if most_files else []
    with log.open("a", encoding="utf-8") as errors:
        process = subprocess.Popen([*limit, *MIRRORMOUNT, *words], stdout=subprocess.PIPE, stderr=errors, text=True)
    assert process.stdout
    for line in process.stdout:
        if "ready" in line:
            process.ready = line.strip()  # type: ignore[attr-defined]
            return process
    raise RuntimeError(f"{words[0]} did not start, see {log}")


# ---- stations

Fault = Callable[[], None]


class Station(threading.Thread):
    """A board, the owner of its port, and what happens to them, until stopping is set."""

    kind = ""

    def __init__(self, folder: Path, seed: int, log: Log, stopping: threading.Event) -> None:
        super().__init__(name=self.kind)
        folder.mkdir()
        self.folder, self._log, self._stopping = folder, log, stopping
        self.random = random.Random(f"{seed} {self.kind}")
        self.board = Board(folder / "board")
        self.begin()

    def run(self) -> None:
        """Let things happen."""
        while not self._stopping.is_set():
            try:
                self._episode()
            except Exception as e:  # of this program: told, and no reason to end the other stations
                self._log.event(self.kind, "episode", harness=f"{type(e).__name__}: {e}")
                time.sleep(5)

    # ---- for each kind of owner

    def begin(self) -> None:
        """Start the owner."""
        raise NotImplementedError

    def end(self) -> None:
        """End the owner."""
        raise NotImplementedError

    def drive(self, what: str) -> None:
        """Start a motion: "run" or "steps"."""
        raise NotImplementedError

    def own_stop(self) -> None:
        """Stop by the owner's own way."""
        raise NotImplementedError

    def faults(self) -> dict[str, Fault]:
        """What may happen to this station, by name."""
        raise NotImplementedError

    # ---- what happens

    def _episode(self) -> None:
        what = self.random.choice(("run", "run", "steps"))
        faults = self.faults()
        name = self.random.choice(list(faults))
        with self.crowd() as crowd:
            self.board.forget()
            self.drive(what)
            if not _waited(self.board.drives):
                self._log.event(self.kind, "no drive", motion=what, fault=name, crowd=crowd)
            time.sleep(self.random.uniform(0.05, 1.2))
            self._log.event(self.kind, name, motion=what, crowd=crowd, driving=self.board.driving)
            faults[name]()
        if not self.board.rest():
            self._log.event(self.kind, "rest", violation="a motor does not come to rest", fault=name)
        with contextlib.suppress(OSError, WebSocketException):
            self.own_stop()
            time.sleep(0.2)  # what comes next is not what it stops

    @contextlib.contextmanager
    def crowd(self) -> Iterator[int]:
        """Sometimes a crowd of half-open connections at the owner. Yields how many."""
        yield 0

    def judge(self, after: str, wall_s: float, most_s: float) -> None:
        """Nothing may have drive later than most_s after that moment, and nothing starts."""
        end_s = time.monotonic() + most_s + SEEN_S
        while time.monotonic() < end_s:
            self.board.poll()
            time.sleep(0.02)
        if self.board.driving and not self.board.rest():
            self._log.event(self.kind, "judged", violation=f"after {after}: a motor stays on")
            return
        late_s, strictly_s = (round(self.board.late_s(wall_s, within_s), 3) for within_s in (60.0, 5.0))
        self._log.late_s[after].append(strictly_s)
        verdict = {}
        if strictly_s > most_s:
            verdict = {"violation" if late_s > most_s else "doubtful": f"after {after}: on for {late_s} s"}
        self._log.event(self.kind, "judged", after=after, late_s=late_s, strictly_s=strictly_s, **verdict)

    def judge_stillness(self, after: str) -> None:
        """Nothing may start unasked."""
        self.board.forget()
        end_s = time.monotonic() + SEEN_S
        while time.monotonic() < end_s:
            if self.board.drives():
                self._log.event(self.kind, "stillness", violation=f"after {after}: a motor starts unasked")
                return
            time.sleep(0.02)

    def command_stop(self) -> None:
        """`mirrormount stop --port LINK`."""
        words = [*MIRRORMOUNT, "stop", "--port", str(self.board.link)]
        done = subprocess.run(words, capture_output=True, text=True, timeout=60)
        wall_s, told = time.time(), (done.stdout + done.stderr).strip()[:300]
        if done.returncode == 0:
            self.judge("mirrormount stop", wall_s, STOP_S)
        else:
            self._log.event(self.kind, "mirrormount stop", refused=told)

    def wire_stop(self) -> None:
        """The owner's own way."""
        try:
            self.own_stop()
        except (OSError, WebSocketException) as e:
            self._log.event(self.kind, "own stop", refused=repr(e)[:200])
            return
        self.judge(f"{self.kind}'s own stop", time.time(), STOP_S)

    def freeze(self, pid: int) -> None:
        """Freeze a process, see its motors stop, and let it go on."""
        os.kill(pid, signal.SIGSTOP)
        wall_s = time.time()
        try:
            self.judge(f"{self.kind} froze", wall_s, DEATH_S)
        finally:
            os.kill(pid, signal.SIGCONT)
        self.judge_stillness(f"{self.kind} goes on")

    def board_lost(self) -> None:
        """The board is killed, and comes back under another number."""
        self.board.kill()
        if self.random.random() < 0.7:
            self.board.link.unlink()
        if self.random.random() < 0.3 and not self.board.link.exists():
            words = [*MIRRORMOUNT, "stop", "--port", str(self.board.link)]
            done = subprocess.run(words, capture_output=True, text=True, timeout=60)
            if done.returncode == 0:
                self._log.event(self.kind, "no board", violation=f"a stop is told as done: {done.stdout[:200]}")
        time.sleep(self.random.uniform(0, 2))
        self.board.start()
        self.judge_stillness("the board is back")


def _waited(condition: Callable[[], bool]) -> bool:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.01)
    return True


def _port_of(process: subprocess.Popen) -> int:
    return int(re.findall(r":(\d+)", process.ready)[-1])  # type: ignore[attr-defined]


@contextlib.contextmanager
def half_open(port: int, number: int, sent: bytes) -> Iterator[int]:
    """That many connections that never become a request."""
    crowd: list[socket.socket] = []
    try:
        for _ in range(number):
            with contextlib.suppress(OSError):
                crowd.append(socket.create_connection(("127.0.0.1", port), 2))
                crowd[-1].sendall(sent)
        yield len(crowd)
    finally:
        for one in crowd:
            one.close()


class Program(Station):
    """A Python program with a Mount or a Supervisor: this file with --program."""

    _numbers = itertools.count(1)

    def begin(self) -> None:
        words = [sys.executable, "-P", __file__, "--program", self.kind, str(self.board.link)]
        with (self.folder / "program.log").open("a") as log:
            self._process = subprocess.Popen(
                words, bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log
            )

    def end(self) -> None:
        self._process.kill()
        self._process.wait()

    def drive(self, what: str) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            if self._process.poll() is not None:
                self.begin()
            if self._done(self._tell(what)):
                return
            time.sleep(0.5)

    def own_stop(self) -> None:
        if self._process.poll() is None:
            self._done(self._tell("stop"))

    def faults(self) -> dict[str, Fault]:
        more = {"hang": self._hang} if self.kind == "supervisor" else {}
        return {
            "stop": self.command_stop,
            "killed": self._killed,
            "frozen": lambda: self.freeze(self._process.pid),
            "board lost": self.board_lost,
            **more,
        }

    def _tell(self, what: str) -> bytes:
        """Returns the number that the answer will have."""
        number = b"%d" % next(self._numbers)
        assert self._process.stdin
        self._process.stdin.write(number + b" " + what.encode() + b"\n")
        return number

    def _done(self, number: bytes) -> bool:
        """Wait for the answer to an order: nothing of it may come later. True if it is not refused."""
        assert self._process.stdout
        answers = select.poll()  # unlike select() it takes the files of a crowd
        answers.register(self._process.stdout, select.POLLIN)
        while answers.poll(1000 * PATIENCE_S):
            answer = self._process.stdout.readline().split()
            if not answer:
                return False
            if answer[0] == number:
                return answer[1] == b"ok"
        return False

    def _killed(self) -> None:
        self.end()
        self.judge(f"{self.kind} was killed", time.time(), DEATH_S)

    def _hang(self) -> None:
        if self._done(self._tell("hang")):  # it answers, and hangs then
            self.judge("a program hangs", time.time(), DEATH_S)


class OfMount(Program):
    """With a Mount."""

    kind = "mount"


class OfSupervisor(Program):
    """With a Supervisor."""

    kind = "supervisor"


class Serve(Station):
    """A `serve`, and the client that drives."""

    kind = "serve"

    def begin(self) -> None:
        self.process = started(["serve", str(self.board.link), "--tcp", "127.0.0.1:0"], self.folder / "serve.log", 1024)
        self.port = _port_of(self.process)
        self._client: socket.socket | None = None

    def end(self) -> None:
        self.process.kill()
        self.process.wait()

    def drive(self, what: str) -> None:
        orders = {"run": b"1MV+\r", "steps": b"2PR12\r"}
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            with contextlib.suppress(OSError):
                self._connect()
                if self._client:
                    self._client.sendall(orders[what])
                    if _within(self.board.drives, 2):
                        return
            self._leave()
            time.sleep(0.2)

    def _connect(self) -> None:
        if self._client:
            return
        client = socket.create_connection(("127.0.0.1", self.port), 3)
        client.settimeout(3)
        with contextlib.suppress(OSError):
            if client.recv(6)[:1] == b"\xff":
                self._client = client
                return
        client.close()

    def _leave(self) -> None:
        if self._client:
            self._client.close()
        self._client = None

    def own_stop(self) -> None:
        """A further client's stop, or that of the one that drives."""
        if self._client and self.random.random() < 0.5:
            self._client.sendall(b"!")
            return
        with socket.create_connection(("127.0.0.1", self.port), 3) as other:
            other.sendall(b"!")
            other.settimeout(3)
            other.recv(100)  # or its bytes were lost with the connection

    def faults(self) -> dict[str, Fault]:
        return {
            "stop": self.command_stop,
            "wire stop": self.wire_stop,
            "client left": self._client_left,
            "frozen": lambda: self.freeze(self.process.pid),
            "board lost": self.board_lost,
        }

    def _client_left(self) -> None:
        self._leave()
        self.judge("the client left", time.time(), STOP_S)

    @contextlib.contextmanager
    def crowd(self) -> Iterator[int]:
        """Behind the client that drives: the first one of a crowd would drive itself."""
        if self.random.random() < 0.7:
            yield 0
            return
        with contextlib.suppress(OSError):
            self._connect()
        with half_open(self.port, self.random.choice(CROWDS["serve"]), self.random.choice((b"", b"1MV"))) as number:
            yield number


class Page:
    """A page of the panel: it returns each tick until it is frozen or closed."""

    def __init__(self, port: int) -> None:
        where = f"127.0.0.1:{port}"
        with urllib.request.urlopen(f"http://{where}/", timeout=10) as answer:
            found = re.search(r"data-page[^A-Za-z0-9_-]+([A-Za-z0-9_-]{20,24})", answer.read().decode())
        assert found
        self._connection = contextlib.ExitStack()
        socket = connect(f"ws://{where}/drive", proxy=None, ping_interval=None, open_timeout=10)
        self._socket = self._connection.enter_context(socket)
        self._socket.send(json.dumps({"page": found[1], "key": None}))
        self._tick, self.frozen = 0, False
        threading.Thread(target=self._beat, daemon=True).start()

    def _beat(self) -> None:
        with contextlib.suppress(WebSocketException, OSError):
            while True:
                self._tick = json.loads(self._socket.recv())["tick"]
                if not self.frozen:
                    self.send("beat")

    def send(self, what: str, **more: object) -> None:
        """A message with the last tick. Raises WebSocketException."""
        self._socket.send(json.dumps({"do": what, "tick": self._tick, **more}))

    def close(self) -> None:
        """As a browser does when its page is closed."""
        with contextlib.suppress(WebSocketException, OSError):
            self._connection.close()


class Panel(Station):
    """A panel, and the page that drives."""

    kind = "panel"

    def begin(self) -> None:
        words = ["panel", str(self.board.link), "--http", "0", "--no-browser"]
        self.process = started(words, self.folder / "panel.log", 1024)
        self.port = _port_of(self.process)
        self._page: Page | None = None

    def end(self) -> None:
        self.process.kill()
        self.process.wait()

    def drive(self, what: str) -> None:
        orders = {"run": {"do": "drive", "x": 200, "y": 0}, "steps": {"do": "steps", "axis": "y", "way": 1, "n": 12}}
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            try:
                if self._page is None:
                    self._page = Page(self.port)
                    time.sleep(0.3)  # a tick
                self._page.send("claim")
                order = dict(orders[what])
                self._page.send(str(order.pop("do")), **order)
                if _within(self.board.drives, 2):
                    return
            except (OSError, WebSocketException, AssertionError):
                self._leave()
            time.sleep(1)

    def _leave(self) -> None:
        if self._page:
            self._page.close()
        self._page = None

    def own_stop(self) -> None:
        """STOP of the page."""
        if self._page is None:
            self._page = Page(self.port)
        self._page.send("stop")

    def faults(self) -> dict[str, Fault]:
        return {
            "stop": self.command_stop,
            "wire stop": self.wire_stop,
            "POST /stop": self._post,
            "page frozen": self._page_frozen,
            "page closed": self._page_closed,
            "frozen": lambda: self.freeze(self.process.pid),
            "board lost": self.board_lost,
        }

    def _post(self) -> None:
        asking = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        try:
            asking.request("POST", "/stop")
            status = asking.getresponse().status
        except (OSError, http.client.HTTPException) as e:
            self._log.event(self.kind, "POST /stop", refused=repr(e)[:200])
            return
        finally:
            asking.close()
        if status == 204:
            self.judge("POST /stop", time.time(), STOP_S)
        else:
            self._log.event(self.kind, "POST /stop", refused=status)

    def _page_frozen(self) -> None:
        if self._page:
            self._page.frozen = True
            self.judge("the page froze", time.time(), DEATH_S)
            self._page.frozen = False
            self.judge_stillness("the page goes on")

    def _page_closed(self) -> None:
        self._leave()
        self.judge("the page was closed", time.time(), STOP_S)

    @contextlib.contextmanager
    def crowd(self) -> Iterator[int]:
        """Before the page asks, and beside it."""
        if self.random.random() < 0.75:
            yield 0
            return
        with half_open(self.port, self.random.choice(CROWDS["panel"]), self.random.choice(HALVES)) as number:
            yield number


class MortalServe(Serve):
    """A `serve` that is killed while its client drives."""

    kind = "mortal serve"

    def faults(self) -> dict[str, Fault]:
        return {"killed": self._killed}

    def _killed(self) -> None:
        self.end()
        self.judge("serve was killed", time.time(), DEATH_S)
        self._leave()
        self.begin()
        self.judge_stillness("serve is back")


class MortalPanel(Panel):
    """A panel that is killed while its page drives; not often, for one takes seconds to start."""

    kind = "mortal panel"

    def faults(self) -> dict[str, Fault]:
        return {"killed": self._killed}

    def _killed(self) -> None:
        self.end()
        self.judge("panel was killed", time.time(), DEATH_S)
        self._leave()
        self._stopping.wait(60)
        self.begin()
        self.judge_stillness("the panel is back")


def _within(condition: Callable[[], bool], seconds: float) -> bool:
    end_s = time.monotonic() + seconds
    while not (met := condition()) and time.monotonic() < end_s:
        time.sleep(0.01)
    return met


STATIONS = (Panel, Serve, OfSupervisor, OfMount, MortalServe, MortalPanel)


# ---- the program of a station


def program(kind: str, link: str) -> None:
    """Carry out the numbered words of standard input (run, steps, stop, hang) and answer each; ends with the input."""
    from mirrormount import Mount
    from mirrormount.errors import MountError
    from mirrormount.supervise import Supervisor

    owner: Any = None
    client: Any = None
    words = open(0, "rb", buffering=0)  # noqa: SIM115  (select() sees no word that waits in a buffer)
    while True:
        ready = select.select([words], [], [], 0.1)[0]
        if client:
            client.beat()
        if not ready:
            continue
        number, _, word = words.readline().decode().strip().partition(" ")
        if not number:
            return
        try:
            if owner is None:
                owner = Mount.open(link) if kind == "mount" else Supervisor(link).open()
                client = owner.join("endurance") if kind == "supervisor" else None
            if word != "hang":
                _carry_out(word, owner, client)
            print(number, "ok", flush=True)
            if word == "hang":
                time.sleep(2.5)
        except MountError as e:  # the board has gone: the order is given again, as a person would
            print(number, "refused", flush=True)
            print(f"{word}: {e}", file=sys.stderr, flush=True)
            if kind == "mount" and owner:
                owner.close()
                owner = None


def _carry_out(word: str, owner: Any, client: Any) -> None:
    """Raises MountError."""
    if word == "stop":
        (client or owner).stop()
    elif client:
        client.take_control()
        motion = client.jog("x", 0.8) if word == "run" else client.step("y", 12)
        end_s = time.monotonic() + 0.3
        while not motion.done and time.monotonic() < end_s:
            client.beat()
            time.sleep(0.05)
        if motion.done:
            motion.wait()  # raises why it was refused
    elif word == "run":
        owner.x.jog(0.8)
    else:
        owner.y.step(12, wait=False)


# ---- all of it


def sample(process: subprocess.Popen) -> dict[str, int]:
    """Memory in kB, open files and threads of a process."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    found = {name: int(re.findall(rf"{name}:\s+(\d+)", status)[0]) for name in ("VmRSS", "Threads")}
    files = len(os.listdir(f"/proc/{process.pid}/fd"))
    return {"rss_kb": found["VmRSS"], "threads": found["Threads"], "files": files}


def level(samples: list[dict[str, int]]) -> dict[str, object]:
    """Each figure's median of the second quarter and of the last, and whether it has grown: by more than a tenth."""
    quarter = len(samples) // 4
    told: dict[str, object] = {}
    for name in samples[0] if quarter else ():
        second, last = (
            statistics.median(s[name] for s in part) for part in (samples[quarter : 2 * quarter], samples[-quarter:])
        )
        told[name] = {"second quarter": second, "last": last, "grown": last > 1.1 * second + 2}
    return told


def summary(log: Log, samples: dict[str, list[dict[str, int]]]) -> dict[str, object]:
    """The last line."""
    late = {
        after: {"n": len(late_s), "median_s": statistics.median(late_s), "most_s": max(late_s)}
        for after, late_s in sorted(log.late_s.items())
    }
    levels = {name: level(of_process) for name, of_process in samples.items()}
    return {"summary": {"counts": log.counts, "late": late, "levels": levels} | log.found}


def endure(options: argparse.Namespace, folder: Path) -> bool:
    """Run all stations for the time that was asked for. True if nothing happened that must not."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    os.environ["XDG_RUNTIME_DIR"] = os.environ["XDG_STATE_HOME"] = str(folder)  # no stop gets in or out
    os.environ.pop("MIRRORMOUNT_PORT", None)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the end of it is told, and no process is left
    log, stopping = Log(options.json), threading.Event()
    stations = [kind(folder / kind.kind, options.seed, log, stopping) for kind in STATIONS]
    samples: dict[str, list[dict[str, int]]] = defaultdict(list)
    end_s = time.monotonic() + 60 * options.minutes
    for station in stations:
        station.start()
    try:
        while time.monotonic() < end_s:
            time.sleep(min(60.0, max(0.0, end_s - time.monotonic())))
            for station in stations[:2]:
                figures = sample(station.process)  # type: ignore[attr-defined]
                samples[station.kind].append(figures)
                log.event(station.kind, "sample", **figures)
    except KeyboardInterrupt:
        pass
    stopping.set()
    for station in stations:
        station.join()
        station.end()
        station.board.kill()
    told = summary(log, samples)
    log.close(told)
    print(json.dumps(told))
    grown = any(figure["grown"] for of in told["summary"]["levels"].values() for figure in of.values())  # type: ignore
    return not (log.found["violation"] or grown)


def main(arguments: list[str]) -> int:
    """Endure, or be the program of a station."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=120.0, metavar="M", help="how long (default 120)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of what happens; its times are the machine's")
    parser.add_argument("--json", type=Path, default=Path("endurance.json"), metavar="FILE", help="the events")
    parser.add_argument(
        "--folder", type=Path, metavar="DIR", help="keep the edges and the programs' logs in this new folder"
    )
    parser.add_argument("--program", nargs=2, metavar=("KIND", "LINK"), help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.program:
        program(*options.program)
        return 0
    if options.folder:
        options.folder.mkdir()
        return 0 if endure(options, options.folder.absolute()) else 1
    with tempfile.TemporaryDirectory(prefix="endure") as folder:
        return 0 if endure(options, Path(folder)) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
