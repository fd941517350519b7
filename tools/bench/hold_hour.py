"""Holds a virtual table's beam for an hour in real time, at 30 frames a second, while two programs look on.

    .venv/bin/python tools/bench/hold_hour.py [--seconds S] [--profile smooth|rough] [--seed N] [--json FILE]

As `mirrormount hold --page` on a real table: supervised mounts on boards in processes of their own, a log, a page. Each
frame of both cameras goes through spot and loop. The two that look on are processes that ask for state and pictures as
often as a page does. A gate that only a person opens is opened after 5 s, and counted. Linux only.

`--run FOLDER` keeps what an excursion is traced with: the log of the run, the true beam (truth.npy: time of the log,
time of the table, x and y of each camera in um), and the memory of each process (memory.jsonl).
"""

import argparse
import contextlib
import json
import os
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from looking_on import lookers
from numpy.typing import NDArray

from mirrormount.errors import MountError
from mirrormount.supervise.supervisor import Supervisor
from mirrormount.transport.ports import Port
from mirrormount_beam.control import events
from mirrormount_beam.control.backlash import Gap
from mirrormount_beam.control.calibrate import Calibration
from mirrormount_beam.control.hold import Hold, Summary, align
from mirrormount_beam.control.response import Response
from mirrormount_beam.observe import lever_m
from mirrormount_beam.runlog import RunLog
from mirrormount_beam.table import SharedTable, TargetCamera
from mirrormount_panel.auth import SignIn
from mirrormount_panel.hold_page import HoldBoard, make_hold_server
from mirrormount_sim.table import VirtualTable, open_table

Numbers = NDArray[np.float64]
PERIOD_S = 1 / 60  # less than a frame's, so that the frames set the pace
TRUTH_S = 0.1  # between two samples of the true beam
MEMORY_S = 10.0
PERSON_S = 5.0  # until somebody opens a gate
PARTS = 6
ROOM_S = 600.0  # of the truth, beyond what was asked for
TRIES = 5  # to calibrate and align


class Watch:
    """What is measured of the loop. Calls of listen() come from the loop's thread."""

    def __init__(self) -> None:
        self.periods_s: list[float] = []
        self.looks = 0
        self.trips: list[str] = []
        self.person: threading.Event = threading.Event()
        self._last_s: float | None = None

    def begin_anew(self) -> None:
        """Forget what was before."""
        self.periods_s.clear()
        self.looks, self.trips = 0, []

    def listen(self, event: events.Event) -> None:
        """Take an event: two looks with nothing moved between them are a period."""
        match event:
            case events.Observed():
                now_s = time.monotonic()
                if self._last_s is not None:
                    self.periods_s.append(now_s - self._last_s)
                self._last_s = now_s
                self.looks += 1
            case events.Estimated():
                pass  # told with each look
            case events.InterlockTripped():
                self.trips.append(f"{event.number} {event.name}: {event.cause}")
                print(f"interlock {self.trips[-1]}", flush=True)
                self._last_s = None
                if not event.clears_itself:
                    self.person.set()
            case _:
                self._last_s = None


class Truth:
    """Where the beam is, without noise, sampled in the table's own thread: times and the errors of the spots in um.

    Its room is taken at the beginning, so that memory that grows is the product's.
    """

    def __init__(self, table: VirtualTable, targets: Sequence[TargetCamera], seconds: float) -> None:
        self._rows = np.full((int((seconds + ROOM_S) / TRUTH_S), 2 + 2 * len(targets)), np.nan)
        self._count = 0
        self._table, self._targets = table, targets
        self._next_s = table.now_s()
        self.sample()

    def sample(self) -> None:
        """Take one, and order the next while there is room."""
        row = [time.monotonic(), self._next_s]
        for eye, camera, spot in zip(
            self._targets, self._table.cameras, self._table.truth.spots_mm(self._next_s), strict=True
        ):
            x, y = camera.truth_px(spot) if spot else (np.nan, np.nan)
            row += [(x - eye.target_px[0]) * eye.um_per_px[0], -(y - eye.target_px[1]) * eye.um_per_px[1]]
        self._rows[self._count] = row
        self._count += 1
        self._next_s += TRUTH_S
        if self._count < len(self._rows):
            self._table.clock.at(self._next_s, self.sample)

    def rows(self) -> Numbers:
        """All samples: time of the log, time of the table, x and y of each spot."""
        return self._rows[: self._count].copy()


def plugs(table: VirtualTable, number: int) -> Callable[[], Port]:
    """What opens the port of a board, at first and again after it was lost: then it has been switched off and on."""
    ports = iter([table.ports[number]])
    return lambda: next(ports, None) or table.replug(number)


def ready(table: SharedTable, listen: events.Listen) -> tuple[Response, Sequence[Gap], Summary]:
    """Calibrate and align; again where a busy computer has lost a board. Raises MountError at the last of the tries."""
    for left in reversed(range(TRIES)):
        try:
            table.take_control()
            measuring = Calibration(table, listen)
            response = measuring.run()
            summary = align(table, response, measuring.gaps, listen)
            if summary.reached or not left:
                return response, measuring.gaps, summary
        except MountError as e:
            print(f"once more: {e}", flush=True)
            if not left:
                raise
            time.sleep(PERSON_S)
    raise AssertionError


def memory_mb() -> dict[str, float]:
    """Resident memory of this process (loop, page, cameras) and of each that it started, by role."""
    page_mb = os.sysconf("SC_PAGESIZE") / 1e6
    found = {"loop": int(Path("/proc/self/statm").read_text().split()[1]) * page_mb}
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended
            if status.read_text().rpartition(")")[2].split()[1] == str(os.getpid()):
                command = (status.parent / "cmdline").read_bytes()
                role = "page" if b"looking_on.py" in command else "other"
                found[f"{role} {status.parent.name}"] = int((status.parent / "statm").read_text().split()[1]) * page_mb
    return found


def growth(samples: Sequence[dict[str, float]]) -> dict[str, dict[str, float]]:
    """Of each process: memory at the begin, in the middle, at the end, and the most."""
    return {
        role: {
            "begin": samples[0].get(role, 0.0),
            "middle": samples[len(samples) // 2].get(role, 0.0),
            "end": samples[-1].get(role, 0.0),
            "most": max(sample.get(role, 0.0) for sample in samples),
        }
        for role in samples[-1]
    }


def busy_s() -> float:
    """Time in which a processor of this computer was busy, of all processors together."""
    user, nice, system, _, _, irq, soft, *_ = map(int, Path("/proc/stat").read_text().split("\n")[0].split()[1:])
    return (user + nice + system + irq + soft) / os.sysconf("SC_CLK_TCK")


@dataclass
class Held:
    """What an hour has left: its figures are made of it."""

    watch: Watch
    summary: Summary
    errors_um: Numbers  # each spot's x and y, a row for each sample of the truth
    lever_m: float
    seconds: float
    own_s: float  # of a processor, this process
    all_s: float  # of all processors, everything
    memory: Sequence[dict[str, float]]
    looking_on: Sequence[dict[str, float]]
    log_events_lost: int


def cameras_of(table: VirtualTable) -> list[TargetCamera]:
    """An eye for each camera, which holds the middle of its picture."""
    um = 1000 * table.cameras[0].sensor.pixel_mm
    return [
        TargetCamera(camera.name, camera, ((camera.size.width - 1) / 2, (camera.size.height - 1) / 2), (um, um), at_m)
        for camera, at_m in zip(table.cameras, table.truth.geometry.cameras_m, strict=True)
    ]


def hour(options: argparse.Namespace) -> Held:
    """Calibrate, align, hold."""
    address = f"virtual-table://?speed=1&off=2&profile={options.profile}&seed={options.seed}"
    with contextlib.ExitStack() as kept:
        table = kept.enter_context(open_table(address))
        mounts = []
        for number, name in enumerate(("first", "second")):
            supervisor = Supervisor(plugs(table, number), patience_s=options.patience)
            mounts.append((name, kept.enter_context(supervisor), ("x", "y")))
        cameras = cameras_of(table)
        shared = kept.enter_context(SharedTable("hour", mounts, cameras))
        watch, board = Watch(), HoldBoard({camera.name: camera.um_per_px for camera in cameras})
        folder = options.run or Path(kept.enter_context(tempfile.TemporaryDirectory())) / "run"
        log = kept.enter_context(RunLog(folder / "run.sqlite", {"seed": options.seed, "profile": options.profile}))

        def listen(event: events.Event) -> None:
            log(event)
            board.listen(event)
            watch.listen(event)

        response, gaps, summary = ready(shared, listen)
        print(f"aligned in {summary.corrections} corrections", flush=True)
        hold = Hold(shared, response, gaps, listen, period_s=PERIOD_S)
        server = make_hold_server(cameras, board, SignIn(None), go=hold.go_on, stop=hold.stop)
        listener = kept.enter_context(socket.create_server(("127.0.0.1", 0)))
        page = threading.Thread(target=server.run, args=([listener],), daemon=True)
        page.start()
        got: list[dict[str, float]] = []
        with lookers(listener.getsockname()[1], got):
            watch.begin_anew()
            truth = Truth(table, cameras, options.seconds)
            with minded(folder, watch, hold) as memory:
                begun = (time.monotonic(), time.process_time(), busy_s())
                threading.Timer(options.seconds, hold.stop).start()
                summary = hold.run()
                ended = (time.monotonic(), time.process_time(), busy_s())
            rows = truth.rows()
            np.save(folder / "truth.npy", rows)
        server.should_exit = True
        page.join(5)
        seconds, own_s, all_s = (after - before for after, before in zip(ended, begun, strict=True))
        lever = lever_m(cameras) or np.nan
        return Held(watch, summary, rows[:, 2:], lever, seconds, own_s, all_s, memory, got, log.lost)


@contextlib.contextmanager
def minded(folder: Path, watch: Watch, hold: Hold) -> Iterator[list[dict[str, float]]]:
    """Meanwhile memory is sampled, and a person clears the interlocks that only a person clears. Yields the samples."""
    memory: list[dict[str, float]] = []
    ended = threading.Event()

    def sample() -> None:
        while not ended.wait(MEMORY_S):
            memory.append(memory_mb())
            with (folder / "memory.jsonl").open("a") as file:
                file.write(json.dumps({"t": time.monotonic()} | memory[-1]) + "\n")

    def person() -> None:
        while not ended.wait(0.5):
            if watch.person.is_set():
                ended.wait(PERSON_S)
                watch.person.clear()
                hold.go_on()

    threads = [threading.Thread(target=work) for work in (sample, person)]
    for thread in threads:
        thread.start()
    try:
        yield memory
    finally:
        ended.set()
        for thread in threads:
            thread.join()


def figures(options: argparse.Namespace, held: Held) -> dict[str, object]:
    """The figures of an hour, for JSON."""
    errors_um, seconds, watch = held.errors_um, held.seconds, held.watch
    angles = (errors_um[:, 2:4] - errors_um[:, :2]) / held.lever_m
    periods_ms = 1000 * np.array(watch.periods_s)
    parts = [float(np.sqrt((part**2).mean(axis=0)).max()) for part in np.array_split(angles, PARTS)]
    return {
        "profile": options.profile,
        "seed": options.seed,
        "seconds": seconds,
        "rms_urad": float(np.sqrt((angles**2).mean(axis=0)).max()),
        "rms_urad_of_sixths": parts,
        "max_um": float(np.abs(errors_um).max()),
        "over_80_um": float((np.abs(errors_um).max(axis=1) > 80).mean()),
        "seen": held.summary.to_json(final=False) | {"interlocks": watch.trips},
        "looks_a_second": watch.looks / seconds,
        "period_ms": {
            "median": float(np.median(periods_ms)),
            "p99": float(np.quantile(periods_ms, 0.99)),
            "worst": float(periods_ms.max()),
            "over_100": int((periods_ms > 100).sum()),
            "of": len(periods_ms),
        },
        "memory_mb": growth(held.memory),
        "processor": {
            "own": held.own_s / seconds,
            "all": held.all_s / seconds,
            "processors": os.cpu_count(),
        },
        "log_events_lost": held.log_events_lost,
        "looking_on": held.looking_on,
    }


def main(arguments: list[str]) -> int:
    """Hold, and print the figures."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=3600.0, metavar="S")
    parser.add_argument("--profile", choices=("smooth", "rough"), default="rough")
    parser.add_argument("--seed", type=int, default=300)
    parser.add_argument("--patience", type=float, default=2.0, metavar="S", help="as of `mirrormount hold` (2)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to FILE, too")
    parser.add_argument("--run", type=Path, metavar="FOLDER", help="keep log, true beam and memory in this new folder")
    options = parser.parse_args(arguments)
    text = json.dumps(figures(options, hour(options)), indent=1)
    print(text)
    if options.json:
        options.json.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
