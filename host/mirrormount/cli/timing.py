"""`mirrormount check --timing`: a board with an RP2040 times its own drive pins, and a report of it is written.

The firmware runs as it is. Beside it a state machine of the second PIO watches the drive pins, and at each change DMA
copies three words into rings in memory: the pins, the timer, and the time of the last USB packet, which the gate keeps
(docs/gate.md). No instruction of the processor is needed for that, and nothing is written to the flash: a reset of the
board ends it, whoever makes it. The watcher only reads. Times have a resolution of 1 us.
"""

import hashlib
import html
import itertools
import json
import platform
import re
import statistics
import struct
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from importlib.resources import files as package_files
from pathlib import Path
from typing import Any

from mirrormount.deploy import prompt
from mirrormount.device.mount import encode_frame
from mirrormount.errors import CheckFailed
from mirrormount.files import check_writable, write_atomic
from mirrormount.terminal import printable
from mirrormount.transport.link import Link
from mirrormount.transport.ports import open_port
from mountfw import __version__

_MARK = "@mirrormount "
_RAW_PROMPT = b"raw REPL; CTRL-B to exit\r\n>"
_PIECE = 128  # bytes of a script that are sent at once: a board's input has 512
_RING = 1024  # changes that the board keeps
_REST_US = 10_000  # Pins that were low for so long: an episode is over. Lines take 4 ms an axis, a PWM period 0.25.
_WRAP = 1 << 32
_LONGEST_S = 30.0
_KEEP_ALIVE_MS = 100
KEPT_ALIVE = b"XK500"  # what runs ends half a second after the host died
_IDLE_S = 0.3  # After an answer the loop has work for a while, and a frame that comes then waits for it.
LENGTHS_US = (1_000, 5_000, 50_000, 200_000)
SHORTEST_US = 200
_IN_PLACE = "1"

# What the board runs instead of main.py. If it ends, by Ctrl-C, it prints what it saw.
_SCRIPT = """
import binascii, machine, rp2, sys, uctypes
from mountfw.ports import micropython as port
from mountfw.board_file import gate_pins
board = port.find_board()
axes = gate_pins(board)
low = min([min(pins) for pins in axes])
width = max([max(pins) for pins in axes]) - low + 1
@rp2.asm_pio(in_shiftdir=rp2.PIO.SHIFT_LEFT, fifo_join=rp2.PIO.JOIN_RX)
def changes(width=width):  # it runs with globals of its own
    wrap_target()
    label("look")
    mov(isr, null)
    in_(pins, width)
    mov(x, isr)
    jmp(x_not_y, "changed")
    wrap()
    label("changed")
    mov(y, x)
    push(block)
    jmp("look")
ring = 4 * RING
memory = bytearray(4 * ring)
start = (uctypes.addressof(memory) + ring - 1) // ring * ring
for number in (7, 6, 5, 4):
    try:
        watcher = rp2.StateMachine(number, changes, freq=machine.freq() // 2, in_base=machine.Pin(low))
        break
    except (OSError, ValueError):
        pass
copies = [rp2.DMA() for _ in range(3)]
# RP2040 data sheet: RXF of PIO1 3.7, TIMERAWL 4.6.5, DREQ_PIO1_RX0 2.5.3.1
sources = (0x50300020 + 4 * (number - 4), 0x40054028, 0x40054028)
for i in (2, 1, 0):
    copies[i].config(read=sources[i], write=start + i * ring, count=1, trigger=i == 0, ctrl=copies[i].pack_ctrl(
        size=2, inc_read=False, inc_write=True, ring_size=RING_BITS, ring_sel=True, irq_quiet=True,
        treq_sel=12 + number - 4 if i == 0 else 63, chain_to=copies[(i + 1) % 3].channel))
made = port.gate
def gate(board):
    g = made(board)
    if g:
        copies[2].read = g._state + 4 * 5  # _PACKET_AT of rp2_gate.py
    return g
port.gate = gate
watcher.active(1)
try:
    import mountfw.start
finally:
    watcher.active(0)
    made = (copies[1].write - start - ring) // 4
    for copy in copies:
        copy.close()
    wrapped = machine.mem32[start + 2 * ring - 4] != 0
    words = memoryview(memory)[start - uctypes.addressof(memory):]
    print()
    for i in range(3):
        for at in range(i * ring, i * ring + 4 * made, 256):
            piece = words[at:min(at + 256, i * ring + 4 * made)]
            print("MARK[%d, \\"%s\\"]" % (i, binascii.hexlify(piece).decode()))
    about = '", "'.join((sys.implementation._machine, sys.version))
    print("MARK[\\"end\\", %d, %s, %d, \\"%s\\"]" % (wrapped, [list(pins) for pins in axes], low, about))
"""


@dataclass(frozen=True)
class Change:
    """A change of the drive pins. us: of the board's timer; high: which axes have drive; packet_us: the last packet."""

    us: int
    high: tuple[bool, ...]
    packet_us: int


@dataclass
class Seen:
    """What a board has seen of its own pins."""

    changes: list[Change]
    machine: str
    micropython: str

    def episodes(self) -> list[list[Change]]:
        """The changes from one rest of all axes to the next."""
        found: list[list[Change]] = []
        rests_since: int | None = None
        for change in self.changes:
            if not found or (rests_since is not None and _after(change.us, rests_since) > _REST_US):
                if not any(change.high):
                    continue
                found.append([])
            found[-1].append(change)
            rests_since = None if any(change.high) else change.us
        return found


def _after(us: int, since_us: int) -> int:
    """Signed difference of two times of a timer of 32 bits."""
    return (us - since_us + _WRAP // 2) % _WRAP - _WRAP // 2


# ---- on the board


def start(link: Link) -> None:
    """Start the firmware again, with the watcher beside it. Raises CheckFailed; the firmware runs then."""
    works, heard = prompt.takes_programs(link)
    if not works:
        raise CheckFailed("--timing needs MicroPython's prompt at this port, and none came; the firmware goes on")
    link.write(prompt.RAW)
    prompt.receive(link, _RAW_PROMPT, _LONGEST_S)
    link.write(prompt.RESTART)  # an empty memory; main.py is not run
    heard = prompt.receive(link, _RAW_PROMPT, _LONGEST_S)
    script = _SCRIPT.replace("RING_BITS", str((4 * _RING).bit_length() - 1)).replace("RING", str(_RING))
    run(link, script.replace("MARK", _MARK))
    heard = _ask(link, b"\n*IDN?\n", "mirrormount,")
    if not heard:
        said = link.drain(0.2).decode("ascii", "replace").strip().splitlines()
        end(link)
        raise CheckFailed(f"the board cannot time its pins: {printable(said[-1] if said else 'no answer')}")


def run(link: Link, code: str) -> None:
    """Run code at the raw prompt. Raises CheckFailed if the board does not take it."""
    data = code.encode() + prompt.RESTART
    for at in range(0, len(data), _PIECE):
        link.write(data[at : at + _PIECE])
        link.sleep(0.01)
    if b"OK" not in prompt.receive(link, b"OK", _LONGEST_S):
        raise CheckFailed("the board did not take the program that times its pins; reset it")


def read(link: Link) -> Seen:
    """End the firmware, and read what the watcher saw. Raises CheckFailed."""
    link.write(prompt.INTERRUPT)
    rings: list[bytearray] = [bytearray(), bytearray(), bytearray()]
    while True:
        line = link.read_line(_LONGEST_S).strip("\x04")
        if not line.startswith(_MARK):
            continue
        told = json.loads(line.removeprefix(_MARK))
        if told[0] == "end":
            break
        rings[told[0]] += bytes.fromhex(told[1])
    _, wrapped, axes, low, machine, version = told
    if wrapped:
        raise CheckFailed(f"more than {_RING} changes came, which is all that the board keeps: nothing is told")
    masks = [sum(1 << (pin - low) for pin in pins) for pins in axes]
    words = [struct.unpack(f"<{len(ring) // 4}I", ring) for ring in rings]
    changes: list[Change] = []
    for pins, us, packet in zip(*words, strict=True):
        high = tuple(bool(pins & mask) for mask in masks)
        if high != (changes[-1].high if changes else (False,) * len(masks)):  # else a leg, or a pin between them
            changes.append(Change(us, high, packet))
    return Seen(changes, machine, version)


def end(link: Link) -> None:
    """Reset the board from its raw prompt, wherever it is now: main.py starts the firmware as ever."""
    link.write(b"\r" + prompt.INTERRUPT + prompt.RAW)
    link.drain(0.2)
    link.write(b"import machine\nmachine.reset()" + prompt.RESTART)


def _ask(link: Link, question: bytes, begins: str = "") -> str:
    """The first line that begins so; "" if none comes in 10 s."""
    stop = link.monotonic() + 10
    while link.monotonic() < stop:
        link.write(question)
        for line in link.drain(0.1, 1.0).decode("ascii", "replace").splitlines():
            if line.startswith(begins) and line.strip():
                return line.strip()
    return ""


# ---- what is measured

Values = dict[str, list[float]]


@dataclass
class Trials:
    """The episodes that a board was led through, and what each is evaluated as."""

    link: Link
    stops: prompt.StopAnswer
    evaluate: list[Callable[[list[Change], Values], None]] = field(default_factory=list)
    round_trips_ms: list[float] = field(default_factory=list)

    def all(self, n: int, gate: bool) -> None:
        """n trials of each row; without the gate those alone that need no time of a packet.

        Raises CheckFailed if somebody stops the board meanwhile.
        """
        self.ask(KEPT_ALIVE)
        for i in range(n):
            self.pulses(LENGTHS_US[i % len(LENGTHS_US)], (1, 2), "pulse", i)
            self.pulses(SHORTEST_US, (1,), "pulse-shortest", i)
            self.ask(b"*IDN?")
        if gate:
            for i in range(n):
                self.frame(i)
                self.stream(i)
            for i in range(min(n, 5)):
                self.partial(i)
                self.silence(i)
            self.ask(KEPT_ALIVE)

    def move(self, data: bytes) -> None:
        """Write what moves something, unless a stop came. Raises CheckFailed."""
        if not self.stops.write_unless_asked(self.link, data):
            raise CheckFailed("somebody stopped the board: nothing more was driven, and nothing is told")

    def ask(self, line: bytes) -> None:
        """A message and a question, whose answer is timed."""
        began = self.link.monotonic()
        self.link.ask(line + b";*IDN?\n" if line != b"*IDN?" else b"*IDN?\n", 5.0)
        if line == b"*IDN?":
            self.round_trips_ms.append((self.link.monotonic() - began) * 1000)

    def pulses(self, us: int, axes: Sequence[int], row: str, i: int) -> None:
        """One pulse of each axis at once."""
        velocity = b"%d.%02d" % divmod(100_000_000 // (us + 1_000), 100)
        self.ask(b";".join(b"%dXP%d;%dVA%s" % (axis, us, axis, velocity) for axis in axes))
        self.link.sleep(0.02)
        self.move(b";".join(b"%dPR%d" % (axis, -1 if i % 2 else 1) for axis in axes) + b"\n")
        self.link.sleep(us * 1e-6 + 0.05)
        self.evaluate.append(lambda seen, values: values[row].extend(t - us for t in _on_us(seen, axes)))

    def frame(self, i: int) -> None:
        """Both motors at full duty by a frame, and a stop."""
        self.link.sleep(_IDLE_S)
        self.move(encode_frame(*(-255, 255) if i % 2 else (255, -255)))
        self.link.sleep(0.02 + i % 7 * 0.003)
        self.halt()
        self.evaluate.append(_frame_and_stop)

    def stream(self, i: int) -> None:
        """The same frame each millisecond, and a stop among them."""
        for _ in range(40):
            self.move(encode_frame(255, 255) if i % 2 else encode_frame(-255, -255))
            self.link.sleep(0.001)
        self.halt()
        self.evaluate.append(lambda seen, values: values["stop-stream-gate"].append(_since_packet(seen[-1])))

    def partial(self, i: int) -> None:
        """A frame of partial duty, whose last byte comes alone; the stop soon, for each period is two changes."""
        self.link.sleep(_IDLE_S)
        frame = encode_frame(*(-120, 120) if i % 2 else (120, -120))
        self.move(frame[:7])
        self.link.sleep(0.02)
        self.move(frame[7:])
        self.link.sleep(0.004)
        self.halt()
        self.evaluate.append(lambda seen, values: values["frame-alone"].append(_both_high(seen)))

    def silence(self, i: int) -> None:
        """Two runs, and no more bytes: the keep-alive ends them."""
        self.link.sleep(0.02)
        self.move(b"XK%d;1MV%s;2MV%s\n" % (_KEEP_ALIVE_MS, *((b"-", b"+") if i % 2 else (b"+", b"-"))))
        self.link.sleep(_KEEP_ALIVE_MS / 1000 + 0.1)
        self.ask(KEPT_ALIVE)
        self.evaluate.append(lambda seen, values: values["keep-alive"].append(_since_packet(seen[-1]) - _KEEP_ALIVE_MS))

    def halt(self) -> None:
        """A stop, alone in its packet, and a rest."""
        self.link.write(b"!")
        self.link.sleep(0.02)
        self.link.write(b"\n")
        self.ask(KEPT_ALIVE)
        self.link.sleep(0.01)

    def values(self, seen: Seen) -> Values:
        """What the trials gave, by row. Raises CheckFailed if the board has seen others."""
        episodes = seen.episodes()
        if len(episodes) != len(self.evaluate):
            raise CheckFailed(
                f"the board was given {len(self.evaluate)} motions and has seen {len(episodes)}: nothing is told"
            )
        values: Values = {name: [] for name in MEASURED}
        for episode, evaluate in zip(episodes, self.evaluate, strict=True):
            evaluate(episode, values)
        return {name: found for name, found in values.items() if found}


MEASURED = ("frame-burst", "frame-alone", "stop-run-gate", "stop-stream-gate", "pulse", "pulse-shortest", "keep-alive")
NOTES = (
    "The emulator's figures are those of docs/performance.md, the board's are by its own timer, to 1 µs: from the"
    " interrupt of the USB packet on, which only the gate times; of pulses 1 to 200 ms long; of `XK100`.",
    "Rows without a figure of the board need a firmware without the gate, or one that hangs; frames in better pace"
    " than a host's clock has; a switch that a person turns; a write to the flash; or a clock that runs in a reset.",
)


def _on_us(seen: list[Change], axes: Sequence[int]) -> list[int]:
    """How long each of these axes had drive, from its first rise to its last fall."""
    times = []
    for axis in axes:
        high = [change.us for change in seen if change.high[axis - 1]]
        fell = [now.us for before, now in itertools.pairwise(seen) if before.high[axis - 1] > now.high[axis - 1]]
        if not high or not fell:
            raise CheckFailed(f"axis {axis} had no drive in a motion that was asked for: nothing is told")
        times.append(_after(fell[-1], high[0]))
    return times


def _since_packet(change: Change) -> float:
    """ms from the last packet to this change."""
    return _after(change.us, change.packet_us) / 1000


def _both_high(seen: list[Change]) -> float:
    """ms from the packet to the moment at which each of both axes had drive once."""
    first = [next((change for change in seen if change.high[axis]), seen[-1]) for axis in (0, 1)]
    last = max(first, key=lambda change: _after(change.us, seen[0].us))
    return _since_packet(last)


def _frame_and_stop(seen: list[Change], values: Values) -> None:
    values["frame-burst"].append(_both_high(seen))
    values["stop-run-gate"].append(_since_packet(seen[-1]))


# ---- the report


def emulated() -> list[dict]:
    """The rows of docs/performance.md, which tools/tables.py copies: name, what, unit, n, median, p99, worst, must."""
    return json.loads(package_files("mirrormount").joinpath("performance.json").read_text(encoding="utf-8"))


def report(about: dict[str, str], values: Values, round_trips_ms: Sequence[float]) -> dict:
    """The report as data: what ran, and each row of docs/performance.md with what the board has measured."""
    rows = [{**row, "board": _summary(values.get(row["name"], ()))} for row in emulated()]
    trips = _summary(round_trips_ms)
    return {"about": about, "notes": NOTES, "rows": rows, "round_trip_of_IDN_ms_by_the_host": trips}


def _summary(values: Sequence[float]) -> dict[str, Any] | None:
    """How many values, their magnitudes' median and largest, and themselves; None without any."""
    if not values:
        return None
    sizes = [abs(value) for value in values]
    median, worst = round(statistics.median(sizes), 4), round(max(sizes), 4)
    return {"n": len(sizes), "median": median, "worst": worst, "values": list(values)}


_HEAD = """<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Timing of a board</title><style>:root{color-scheme:light dark}body{font-family:sans-serif;max-width:70rem;
margin:auto;padding:1rem}div{overflow-x:auto}td,th{padding:.25rem .5rem;text-align:left;vertical-align:top}
td:nth-child(n+3){text-align:right}</style><h1>Timing of a board</h1>"""
_COLUMNS = ("row", "unit", "emulator, median", "worst", "board, n", "median", "worst")


def html_of(told: dict, send: str) -> str:
    """The report as one page."""
    rows = [
        (row["what"], row["unit"], row["median"], row["worst"], *list((row["board"] or {}).values())[:3])
        for row in told["rows"]
    ]
    notes = [*told["notes"], send]
    if trips := told["round_trip_of_IDN_ms_by_the_host"]:
        sizes = f"median {trips['median']:.3g} ms, worst {trips['worst']:.3g} ms"
        notes.insert(0, f"The host timed {trips['n']} round trips of `*IDN?`: {sizes}.")
    paragraphs = "".join(f"<p>{_marked(note)}" for note in notes)
    return f"{_HEAD}{_table(told['about'].items())}{_table([_COLUMNS, *rows])}{paragraphs}\n"


def _table(rows: Iterable[Iterable[object]]) -> str:
    lines = ("".join(f"<td>{_marked(cell)}" for cell in row) for row in rows)
    return f"<div><table>{''.join(f'<tr>{line}' for line in lines)}</table></div>"


def _marked(text: object) -> str:
    """The text in HTML; what stands between backticks is code."""
    return re.sub("`(.+?)`", r"<code>\1</code>", html.escape(str(text)))


def timed(link: Link, stops: prompt.StopAnswer, n: int) -> tuple[dict, Seen]:
    """Lead a board at rest through all trials, and reset it. Returns the report and what the board saw.

    Raises CheckFailed, MountError; the board is reset in any case.
    """
    identity, firmware, health = (_ask(link, question) for question in (b"*IDN?\n", b"XF?\n", b"XH?\n"))
    if why := refusal(identity, health):
        raise CheckFailed(f"--timing is not possible here: {why}")
    try:
        start(link)
        trials = Trials(link, stops)
        trials.all(n, health.split(",")[-1] == _IN_PLACE)
        seen = read(link)
    finally:
        end(link)
    _, name, uid, version = (identity + ",,,").split(",")[:4]
    about = {
        "board": f"{name} ({seen.machine})",
        "board's number, hashed": hashlib.sha256(uid.encode()).hexdigest()[:12],
        "mountfw": version,
        "firmware": firmware[:19],
        "MicroPython": seen.micropython,
        "host": f"mirrormount {__version__}, Python {platform.python_version()}, {platform.system()}",
        "day": time.strftime("%Y-%m-%d", time.gmtime()),
    }
    return report(about, trials.values(seen), trials.round_trips_ms), seen


def run_timing(port: str, to: Path, ask: Callable[[str], bool] | None, n: int = 20) -> tuple[Path, Path]:
    """Ask whether the motors' supply is off (ask; None: it was said), time the board, and write TO.json and TO.html.

    Returns their paths. Raises CheckFailed, MountError.
    """
    if ask and not ask(
        "The motors' supply must be off: the drive pins are driven for half a minute, and what the board knows of its"
        " positions is lost. Is it off?"
    ):
        raise CheckFailed("nothing was timed: switch the motors' supply off, then say yes, or --supply-off")
    check_writable(to.with_suffix(".json"))
    with prompt.stop_answered(port) as answer:
        link = Link(open_port(port))
        try:
            answer.asking(link)
            prompt.quiet(link, stop=False)
            told, _ = timed(link, answer, n)
        finally:
            link.close()
    pages = write(told, to)
    if "://" not in port:
        from mirrormount.deploy.micropython import come_back

        come_back(port, None)
    return pages


def refusal(identity: str, health: str) -> str:
    """Why this board cannot time its pins; "" if it can be tried."""
    if re.search(r"pico ?2|rp2350", identity, re.IGNORECASE):
        return "an RP2350 has its timer and its pins elsewhere, and nothing was tried there"
    if health.split(",")[-1] == "0":
        return "only MicroPython on an RP2040 can time its own pins (XH? tells no gate)"
    return ""


def write(told: dict, to: Path) -> tuple[Path, Path]:
    """Write TO.json and TO.html. Returns their paths. Raises CannotWrite."""
    pages = to.with_suffix(".json"), to.with_suffix(".html")
    write_atomic(pages[0], json.dumps(told, indent=1, ensure_ascii=False) + "\n")
    write_atomic(pages[1], html_of(told, SEND.format(file=pages[0].name)))
    return pages


SEND = "To send it: open an issue of this project and attach {file} (docs/hardware.md)."
