"""Measures `mirrormount ioc` with many axes: are all updates told, does each move end where it should, is memory flat?

    .venv/bin/python tools/bench/axes.py [--mounts N] [--minutes M] [--load N]

The boards are stand-ins, all in one process: they answer what a supervisor asks, and count ten steps a second by the
clock. They are not the firmware, and load the IOC alone. All axes go to and fro together; a client monitors RBV, DRBV
and RRBV of each, so each step is three updates. A step that none of the three has told was not seen: the computer was
too busy to ask the board within the step. One that some of them have told is lost on its way to the client.
"""

import argparse
import asyncio
import contextlib
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from contextlib import ExitStack

import _paths  # noqa: F401  (the tests' helpers)
from iocs import PREFIX, Ioc, free_port

STEPS, STEPS_S = 60, 10.0  # of a move; a second
FIELDS = ("RBV", "DRBV", "RRBV")
_ANSWERS = {"XP": "50000", "VA": f"{STEPS_S:g}", "XD": "255", "XV": "255", "XM": "10000", "TB": "0, NO ERROR DETECTED"}
_COMMAND = re.compile(r"(\d?)([A-Z*]+)(.*)")
_DONE, _STOPPED, _ABORTED = 1, 2, 3  # reasons of the end of a motion (docs/errors.md)


# ---- stand-ins


class StandIn:
    """A board with two axes that move by the clock."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.ends, self.begins, self.begun_s = [0, 0], [0, 0], [0.0, 0.0]
        self.why = [0, 0]

    def where(self, i: int) -> tuple[int, int]:
        """Position and direction now."""
        way = self.ends[i] - self.begins[i]
        gone = min(abs(way), int((time.monotonic() - self.begun_s[i]) * STEPS_S))
        direction = (way > 0) - (way < 0)
        if gone == abs(way):
            self.begins[i] = self.ends[i]
            direction = 0
        return self.begins[i] + gone * ((way > 0) - (way < 0)), direction

    def stop(self, i: int, why: int) -> None:
        """The axis rests where it is."""
        position, direction = self.where(i)
        if direction:
            self.begins[i] = self.ends[i] = position
            self.why[i] = why

    def answer(self, line: str) -> str:
        """What the board replies."""
        return "; ".join(filter(None, map(self._answered, line.split(";"))))

    def _answered(self, text: str) -> str:
        match = _COMMAND.match(text.strip())
        if not match:
            return ""
        i, command, value = int(match[1] or 1) - 1, match[2], match[3]
        if value == "?" and command == "XS":
            axes = ((*self.where(j), self.why[j]) for j in (0, 1))
            told = (f"{1000 * at},{int(way != 0)},{way},0,{why},1" for at, way, why in axes)
            return f"7,{int(time.monotonic() * 1000) % (1 << 29)},0|" + "|".join(told)
        if value == "?":
            own = {
                "*IDN": f"mirrormount,stand-in,{self.number:016x},0.2.0",
                "MD": str(int(not self.where(i)[1])),
                "XE": f"{self.why[i]},0,0",
            }
            return (own | _ANSWERS).get(command, "0")
        if command == "PA":
            self.begins[i], self.ends[i] = self.where(i)[0], int(value)
            self.begun_s[i], self.why[i] = time.monotonic(), _DONE
        elif command == "ST":
            self.stop(i, _STOPPED)
        return ""

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One client."""
        text = ""
        with contextlib.suppress(ConnectionResetError):  # the IOC has ended
            while data := await reader.read(4096):
                text += data.decode("ascii", "replace")
                if "!" in text:
                    text = text.replace("!", "")
                    self.stop(0, _ABORTED)
                    self.stop(1, _ABORTED)
                *lines, text = text.split("\n")
                for line in lines:
                    if told := self.answer(line):
                        writer.write(f"{told}\r\n".encode())


async def _serve_all(first_port: int, n: int) -> None:
    for i in range(n):
        await asyncio.start_server(StandIn(i).serve, "127.0.0.1", first_port + i)
    print("ready", flush=True)
    await asyncio.Event().wait()


# ---- the measurement


class Used:
    """What the IOC has used since the last question."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._last = self._now()

    def _now(self) -> tuple[float, float]:
        with open(f"/proc/{self._pid}/stat") as file:
            fields = file.read().rpartition(")")[2].split()
        return time.monotonic(), (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def processor(self) -> float:
        """Part of one processor."""
        (before_s, before), self._last = self._last, self._now()
        return (self._last[1] - before) / (self._last[0] - before_s)

    def memory_mb(self) -> float:
        """Resident."""
        with open(f"/proc/{self._pid}/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure(names: list[str], minutes: float, used: Used) -> None:
    """Prints a line for each leg. Raises nothing if updates are lost: it tells them."""
    import epics

    told: defaultdict[str, set[float]] = defaultdict(set)

    def count(pvname: str = "", value: float = 0, **_: object) -> None:
        told[pvname].add(value)

    over = threading.Semaphore(0)

    def ended(**_: object) -> None:
        over.release()

    targets = {name: epics.PV(f"{name}.VAL") for name in names}
    monitors = [epics.PV(f"{name}.{field}", callback=count, auto_monitor=True) for name in names for field in FIELDS]
    assert all(pv.wait_for_connection(60) for pv in (*targets.values(), *monitors))
    time.sleep(1)
    end_s, leg, sums = time.monotonic() + 60 * minutes, 0, [0, 0, 0]
    while time.monotonic() < end_s or leg % 2:
        leg += 1
        target = STEPS * (leg % 2)
        told.clear()
        used.processor()
        for pv in targets.values():
            pv.put(target, callback=ended)
        begun_s = time.monotonic()
        for _ in names:
            assert over.acquire(timeout=120), "a put-callback did not come"
        took_s, processor = time.monotonic() - begun_s, used.processor()
        time.sleep(0.5)
        came = {name: [told[f"{name}.{field}"] for field in FIELDS] for name in names}
        steps = set(range(STEPS + 1)) - {STEPS - target}
        unseen = sum(len(steps - set.union(*each)) for each in came.values())
        lost = sum(len(set.union(*each) - one) for each in came.values() for one in each)
        short = [name for name in names if epics.caget(f"{name}.RBV") != target]
        sums = [sum(pair) for pair in zip(sums, (unseen, lost, len(short)), strict=True)]
        print(
            f"leg {leg:4}: {took_s:5.1f} s, {unseen} of {len(names) * STEPS} steps unseen, {lost} updates lost,"
            f" {len(short)} short, {processor:.0%} of a processor, {used.memory_mb():.1f} MB,"
            f" load {os.getloadavg()[0]:.1f}",
            flush=True,
        )
        for name in short[:3]:
            why = (f"{name}.WHY", f"{name}.ESTP$", f"{name.rpartition(':')[0]}.MSG$")
            print("  ", name, epics.caget(f"{name}.RBV"), *(epics.caget(each, as_string=True) for each in why))
        for name in short:
            epics.caput(f"{name}.SPMG", 3, wait=True)
    print(f"{leg} legs of {len(names)} axes: {sums[0]} steps unseen, {sums[1]} updates lost, {sums[2]} moves short")


def main() -> None:
    """Prints lines."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--mounts", type=int, default=50, help="stand-ins, of two axes each (50)")
    parser.add_argument("--minutes", type=float, default=60, help="for so long (60)")
    parser.add_argument("--patience", default="1", help="as of the IOC (1)")
    parser.add_argument("--load", type=int, default=0, help="processes that compete for the processors (0)")
    parser.add_argument(
        "--stand-ins", type=int, metavar="PORT", help="serve the stand-ins from this port on, and no more"
    )
    args = parser.parse_args()
    if args.stand_ins:
        asyncio.run(_serve_all(args.stand_ins, args.mounts))
    port = free_port()
    with ExitStack() as stack:
        os.environ["MIRRORMOUNT_CONFIG"] = stack.enter_context(tempfile.TemporaryDirectory())
        words = [sys.executable, "-P", __file__, "--stand-ins", str(port), "--mounts", str(args.mounts)]
        here = os.environ | {"PYTHONPATH": os.path.dirname(os.path.abspath(__file__))}  # for _paths
        boards = stack.enter_context(subprocess.Popen(words, stdout=subprocess.PIPE, env=here))
        stack.callback(boards.kill)
        assert boards.stdout and boards.stdout.readline()
        addresses = [f"socket://127.0.0.1:{port + i}" for i in range(args.mounts)]
        ioc = stack.enter_context(Ioc(*addresses, "--patience", args.patience))
        for _ in range(args.load):
            stack.callback(subprocess.Popen([sys.executable, "-P", "-c", "while True: pass"]).kill)
        os.environ |= ioc.environment
        names = [f"{PREFIX}m{i}:{axis}" for i in range(1, args.mounts + 1) for axis in "xy"]
        measure(names, args.minutes, Used(ioc.process.pid))
    sys.stdout.flush()
    os._exit(0)  # pyepics' threads


if __name__ == "__main__":
    main()
