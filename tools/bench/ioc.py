"""Measures `mirrormount ioc` from a put to the pins and back, with pyepics on the loopback interface.

    .venv/bin/python tools/bench/ioc.py [--n N] [--mounts M] [--beside PV@PORT ...] [--json FILE]

Each virtual board (`cpython`, in real time), the IOC and the client are processes of their own. With --mounts, so many
boards move at the same time, and the first one is measured. The end of an order is the line that the board writes about
its enable; both times are this computer's clock, so the figures are those of this computer, as busy as it was. The last
rows are puts with callback that begin nothing: of .TWV here, and with --beside of fields of other IOCs on this computer
(a number; their port of Channel Access), each in turn.
Goals: docs/control-systems.md.
"""

import argparse
import json
import math
import os
import random
import statistics
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import _paths  # noqa: F401  (the tests' helpers)
from iocs import PREFIX, Ioc
from served import ServedBoard, wait_for

# 99 % of 200, one mount, a quiet computer
GOALS_MS = {"put to pin": 20, "pin off to callback": 25, "axis STOP to pin off": 15, "mount STOP to pin off": 10}


_GO = 3
_STALL_S = 5.0
_REST_S = 0.6  # of the board after a pulse: a put within it waits for its end


class Watch:
    """The enables of a board as they are written, with the wall's clock."""

    def __init__(self, board: ServedBoard) -> None:
        self.seen: list[tuple[float, int]] = []
        self._board = board
        threading.Thread(target=self._follow, daemon=True).start()

    def _follow(self) -> None:
        wait_for(self._board.edges_file.exists, "the edges")
        with self._board.edges_file.open() as file:
            line = ""
            while True:
                line += file.readline()
                if not line.endswith("\n"):
                    time.sleep(0.0005)
                    continue
                edge, line = json.loads(line), ""
                if "duty" in edge:
                    self.seen.append((time.monotonic(), edge["duty"]))

    def after(self, since_s: float, *, on: bool) -> float:
        """When an enable went on, or the last one went off, since then; waits for it. nan if it does not come.

        That is where a busy computer has stalled a process for so long that the board or the IOC ended the motion.
        """

        def found() -> list[float]:
            return [at for at, duty in list(self.seen) if at > since_s and bool(duty) == on]

        end_s = time.monotonic() + _STALL_S
        while not found():
            if time.monotonic() > end_s:
                return math.nan
            time.sleep(0.001)
        return found()[0 if on else -1]


def measure(n: int, watch: Watch, others: list[str], beside: list[str]) -> dict[str, list[float]]:
    """Milliseconds of each row, n of each. others: axes that move meanwhile. beside: fields of other IOCs."""
    import epics

    axis = f"{PREFIX}m1:x"
    rows: dict[str, list[float]] = {name: [] for name in GOALS_MS}
    target, stop, all_off = (epics.PV(name) for name in (f"{axis}.VAL", f"{axis}.STOP", f"{PREFIX}m1.STOP"))
    for pv in (target, stop, all_off):
        assert pv.wait_for_connection(30), pv.pvname
    busy = [epics.PV(name) for name in others]
    place, gate, cut = epics.PV(f"{axis}.RBV"), epics.PV(f"{axis}.SPMG"), 0

    def was_cut() -> bool:
        """Was the computer so busy that the IOC's supervisor has stopped the axis? Then go on."""
        stopped = gate.get() != _GO
        if stopped:
            gate.put(_GO, wait=True)
        return stopped

    for i in range(n):
        for pv in busy:
            pv.put(10 * (-1) ** i)
        time.sleep(_REST_S)
        goal = 0 if (place.get() or 0) > 0.5 else 1  # after a cut it may be anywhere
        begun_s = time.monotonic()
        assert target.put(goal, wait=True, timeout=60) == 1
        done_s = time.monotonic()
        if was_cut():
            cut += 1
            continue
        rows["put to pin"].append(watch.after(begun_s, on=True) - begun_s)
        rows["pin off to callback"].append(done_s - watch.after(begun_s, on=False))
    for name, pv in (("axis STOP to pin off", stop), ("mount STOP to pin off", all_off)):
        for i in range(n):
            cut += was_cut()
            begun_s = time.monotonic()
            epics.caput(f"{axis}.JOG{'FR'[i % 2]}", 1)
            watch.after(begun_s, on=True)
            time.sleep(random.uniform(0.1, 0.3))
            asked_s = time.monotonic()
            pv.put(1)
            rows[name].append(watch.after(asked_s, on=False) - asked_s)
            wait_for(lambda: epics.caget(f"{axis}.DMOV") == 1, "the end")
    puts = {f"put of {name}": epics.PV(name) for name in (f"{axis}.TWV", *beside)}
    rows |= {name: [] for name in puts}
    for i in range(n):
        for name, pv in puts.items():
            assert pv.wait_for_connection(30), name
            begun_s = time.monotonic()
            assert pv.put(1 + i % 2, wait=True, timeout=60) == 1
            rows[name].append(time.monotonic() - begun_s)
    cut += sum(map(math.isnan, (value for values in rows.values() for value in values)))
    print(f"{cut} motions cut by a busy computer")
    return {name: [1000 * value for value in values if not math.isnan(value)] for name, values in rows.items()}


def main() -> None:
    """Prints a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--n", type=int, default=200, help="repetitions of each row")
    parser.add_argument("--mounts", type=int, default=1, help="virtual boards")
    parser.add_argument("--beside", nargs="*", default=[], metavar="PV@PORT", help="fields of other IOCs")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep every value")
    args = parser.parse_args()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        os.environ["MIRRORMOUNT_CONFIG"] = str(folder / "settings")
        boards = [stack.enter_context(ServedBoard(folder / f"board{i}")) for i in range(args.mounts)]
        watch = Watch(boards[0])
        ioc = stack.enter_context(Ioc("--patience", "2", *(str(board.link) for board in boards)))
        os.environ |= ioc.environment
        beside = dict(one.rsplit("@", 1) for one in args.beside)
        os.environ["EPICS_CA_ADDR_LIST"] += "".join(f" 127.0.0.1:{port}" for port in beside.values())
        rows = measure(args.n, watch, [f"{PREFIX}m{i}:x.VAL" for i in range(2, args.mounts + 1)], list(beside))
    print(f"n = {args.n}, {args.mounts} mounts, load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    print(f"{'':24}  median     p99     max    goal (p99), ms")
    for name, values in rows.items():
        p99 = sorted(values)[min(len(values) - 1, int(0.99 * len(values)))]
        print(f"{name:24} {statistics.median(values):7.1f} {p99:7.1f} {max(values):7.1f} {GOALS_MS.get(name, ''):>7}")
    if args.json:
        args.json.write_text(json.dumps(rows), "utf-8")
    sys.stdout.flush()
    os._exit(0)  # pyepics' threads


if __name__ == "__main__":
    main()
