"""Draw the wirings of docs/bring-up.md, one a bridge, docs/images/wiring*.svg and .png: python tools/wiring.py

Needs schemdraw and matplotlib (in tests/requirements.txt); the same versions write the same bytes.
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
matplotlib.rcParams.update({"svg.hashsalt": "mirrormount", "svg.fonttype": "path"})

import schemdraw  # noqa: E402  (it looks at the backend that was just chosen)
from schemdraw import elements as elm  # noqa: E402

Place = tuple[float, float]
IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
BLACK, GREY, RED, ORANGE, BLUE, GREEN = "black", "#555555", "#b00020", "#b35900", "#0b5394", "#1b6b2f"
SMALL, NORMAL, LARGE = 11, 13, 16
LABEL_OFFSET = (-0.1, -0.1)  # schemdraw puts a label that stands alone this far off

# Name, colour, height on the page, Pico pin and its number, bridge input and its number or None. The signals run
# straight across; the enables are outermost, so that their pull-downs cross nothing.
Signal = tuple[str, str, float, str, int, str, int | None]
# Name, what it does, colour, then the output at either end: name, number or None, height
Output = tuple[str, int | None, float]


@dataclass(frozen=True)
class Bridge:
    """An H-bridge as it is wired. A carrier's pins have names and no numbers."""

    name: str
    file: str
    signals: tuple[Signal, ...]
    outputs: tuple[tuple[Output, Output], tuple[Output, Output]]  # of motors 1 and 2, the upper one first
    logic: tuple[str, int | None]
    logic_from: tuple[str, int, str]  # the Pico's pin, its number, and what is written at the wire
    supply: tuple[str, int | None]
    grounds: tuple[int | None, ...]
    pull_down: str
    notes: str


EMERGENCY_STOP = ("emergency_stop", 2.4, "GP14", 19)  # as in SWITCHES, in the colour of the motors' supply
# Name, colour, height, Pico pin and its number
SWITCHES = (
    ("m1_sw_pos", BLUE, 10.5, "GP10", 14),
    ("m1_sw_neg", BLUE, 8.5, "GP11", 15),
    ("m2_sw_pos", GREEN, 6.0, "GP12", 16),
    ("m2_sw_neg", GREEN, 4.0, "GP13", 17),
)
MOTORS = (("motor 1\nup / down", BLUE), ("motor 2\nright / left", GREEN))
SN754410 = Bridge(
    name="SN754410",
    file="wiring",
    signals=(
        ("m1_en", BLUE, 10.5, "GP2", 4, "1,2EN", 1),
        ("m1_pos", BLUE, 9.0, "GP3", 5, "2A", 7),
        ("m1_neg", BLUE, 7.5, "GP4", 6, "1A", 2),
        ("m2_pos", GREEN, 6.0, "GP6", 9, "4A", 15),
        ("m2_neg", GREEN, 4.5, "GP7", 10, "3A", 10),
        ("m2_en", GREEN, 3.0, "GP5", 7, "3,4EN", 9),
    ),
    outputs=((("2Y", 6, 10.5), ("1Y", 3, 7.5)), (("4Y", 14, 6.0), ("3Y", 11, 3.0))),
    logic=("VCC1", 16),
    logic_from=("VBUS", 40, "5 V from USB, for the bridge's logic"),
    supply=("VCC2", 8),
    grounds=(4, 5, 12, 13),
    pull_down="10 kΩ",
    notes="""
•  R1 and R2 keep the motors off while the board starts or is flashed: 10 kΩ; on a Pico 2, at most 8.2 kΩ.
•  C1 and C2 stand next to the bridge, between pin 8 and its ground pins; C3 stands at pin 16.
•  USB feeds the Pico and pin 16; the motor supply feeds pin 8 and nothing else.
    The two share only the ground. No GP pin may see more than 3.3 V.
""",
)
CARRIER = """
•  C1 and C2 stand next to the carrier, between {} and GND, also if the carrier has capacitors of its own.
•  USB feeds the Pico; the motor supply feeds {} and nothing else.
    The two share only the ground. No GP pin may see more than 3.3 V.
•  The pins' order differs from carrier to carrier: go by their names. No flyback diodes are needed.
"""
TB6612 = Bridge(
    name="TB6612\ncarrier",
    file="wiring-tb6612",
    signals=tuple(
        (*row[:5], name, None)
        for row, name in zip(SN754410.signals, ("PWMA", "AIN1", "AIN2", "BIN1", "BIN2", "PWMB"), strict=True)
    ),
    outputs=((("AO1", None, 10.5), ("AO2", None, 7.5)), (("BO1", None, 6.0), ("BO2", None, 3.0))),
    logic=("VCC, STBY", None),
    logic_from=("3V3", 36, "3.3 V from the Pico"),
    supply=("VM", None),
    grounds=(None, None),
    pull_down="10 kΩ",
    notes="""
•  R1 and R2 keep the motors off while the board starts or is flashed: 10 kΩ; on a Pico 2, at most 8.2 kΩ.
"""
    + CARRIER.lstrip().format("VM", "VM"),
)
DRV8833 = Bridge(
    name="DRV8833\ncarrier",
    file="wiring-drv8833",
    signals=(
        ("m1_pos", BLUE, 10.5, "GP3", 5, "AIN1", None),
        ("m1_neg", BLUE, 8.25, "GP4", 6, "AIN2", None),
        ("m2_pos", GREEN, 6.0, "GP6", 9, "BIN1", None),
        ("m2_neg", GREEN, 3.75, "GP7", 10, "BIN2", None),
    ),
    outputs=((("AOUT1", None, 10.5), ("AOUT2", None, 8.25)), (("BOUT1", None, 6.0), ("BOUT2", None, 3.75))),
    logic=("nSLEEP", None),
    logic_from=("3V3", 36, "3.3 V from the Pico"),
    supply=("VIN or VM", None),
    grounds=(None, None),
    pull_down="8.2 kΩ",
    notes="""
•  R1 to R4, at most 8.2 kΩ, keep the motors off while a Pico 2 starts or is flashed. On a Pico the chip's own
    pull-downs are enough. Board file: mirrormount deploy --board pico_drv8833
•  The wire to nSLEEP is not needed if the carrier pulls it up.
"""
    + CARRIER.lstrip().format("VIN", "VIN"),
)
BRIDGES = (SN754410, TB6612, DRV8833)
NOTES = (
    """
•  Blue: motor 1, up and down. Green: motor 2, right and left. Signal names are the firmware's;
    “pos” is the leg that is high for a positive number.
""",
    """
•  C4 and C5 are soldered to the terminals of the motors, and each motor gets two more, from
    either terminal to its case (drawn at the right). Twist the two leads of a motor.
•  The emergency stop has two normally closed contacts: one breaks the motors' supply, the other
    tells the firmware (optional). D9 blocks a supply whose poles are exchanged.
""",
)  # before and after those of the bridge

RAIL, BOTTOM, GND_3, SUPPLY = 0.0, 1.7, 12.5, 14.5  # heights: ground, boxes, the Pico's GND 3, both supplies
PICO, PICO_RIGHT, PICO_TOP = 6.0, 10.5, 15.5
BRIDGE, BRIDGE_RIGHT, BRIDGE_TOP = 18.5, 23.5, 12.5
PULL_DOWN, LOGIC_CAPACITOR, MOTOR, SMALL_CAPACITOR, BULK_CAPACITOR = 16.0, 17.2, 26.0, 30.0, 32.0  # places across
DIODE, BUTTON, SWITCH, FUSE, SOURCE = 33.0, 36.0, 39.0, 42.0, 45.0  # where each begins, on the way to the supply
NOTES_AT, PINOUT, CLAMPS, NOISE = (0.0, -2.2), (25.0, -1.8), (34.2, -5.3), (43.4, -5.3)


def main() -> None:
    """Draw, and write all files."""
    for bridge in BRIDGES:
        with schemdraw.Drawing(show=False, canvas="matplotlib") as d:
            d.config(fontsize=NORMAL, lw=1.8, margin=0.5, bgcolor="white")
            for part in (supply, pico, chip, signals, motors, switches, clamps, noise, legend):
                part(d, bridge)
        drawn: Any = d.draw(show=False)
        figure = drawn.getfig()
        figure.savefig(IMAGES / f"{bridge.file}.svg", metadata={"Date": None, "Creator": None})
        figure.savefig(IMAGES / f"{bridge.file}.png", dpi=100, metadata={"Software": None})


def wire(d, *places: Place, color: str = BLACK, dot: bool = False) -> None:
    """A wire through some places; with a dot where it ends on another wire."""
    for a, b in pairwise(places):
        d += elm.Line().at(a).to(b).color(color)
    if dot:
        d += elm.Dot().at(places[-1]).color(color)


def write(d, at: Place, words: str, size: int = NORMAL, color: str = BLACK, align: str = "center") -> None:
    """Words; their middle is at that height."""
    style: dict[str, Any] = {"fontsize": size, "color": color, "halign": align, "valign": "center"}
    d += elm.Label().at(at).theta(0).label(words, loc="center", ofst=LABEL_OFFSET, **style)


def box(d, left: float, right: float, bottom: float, top: float, fill: str) -> None:
    """The outline of a part."""
    d += elm.Rect(corner1=(0, 0), corner2=(right - left, top - bottom), fill=fill).at((left, bottom)).theta(0)


def pin(d, at: Place, side: str, name: str, number: int | None) -> None:
    """A pin on one side of a box: its name inside, its number outside if it has one."""
    x, y = at
    dx, dy = {"left": (-1, 0), "right": (1, 0), "top": (0, 1), "bottom": (0, -1)}[side]
    write(d, (x - 0.2 * dx, y - 0.35 * dy), name, align=side if dx else "center")
    if number is None:
        return
    number_at = (x + 0.15 * dx, y + 0.25) if dx else (x + 0.15, y + 0.35 * dy)
    write(d, number_at, str(number), SMALL, GREY, align="right" if side == "left" else "left")


def pico(d, b: Bridge) -> None:
    """The Pico, with the supply of the bridge's logic and its ground."""
    name, number, words = b.logic_from
    box(d, PICO, PICO_RIGHT, BOTTOM, PICO_TOP, "#eaf3e6")
    middle = (PICO + PICO_RIGHT) / 2
    box(d, middle - 0.7, middle + 0.7, PICO_TOP, PICO_TOP + 0.5, "#dddddd")
    write(d, (middle, PICO_TOP + 0.9), "USB, to the computer")
    write(d, (middle - 0.6, 13.0), "Raspberry Pi\nPico (W) or\nPico 2 (W)", LARGE)
    pin(d, (PICO_RIGHT, SUPPLY), "right", name, number)
    if b is not DRV8833:
        pin(d, (PICO_RIGHT, GND_3), "right", "GND", 3)
    pin(d, (middle, BOTTOM), "bottom", "GND", 38)
    wire(d, (middle, BOTTOM), (middle, RAIL), dot=True)
    wire(d, (PICO_RIGHT, SUPPLY), (BRIDGE + 1.4, SUPPLY), (BRIDGE + 1.4, BRIDGE_TOP), color=RED)
    write(d, (14, SUPPLY + 0.35), words, SMALL, RED)
    if b is not SN754410:  # the carriers have one
        return
    d += elm.Capacitor().at((LOGIC_CAPACITOR, SUPPLY)).to((LOGIC_CAPACITOR, GND_3)).dot()
    write(d, (LOGIC_CAPACITOR + 0.45, (SUPPLY + GND_3) / 2), "C3\n100 nF", align="left")


def chip(d, b: Bridge) -> None:
    """The bridge's outline, supplies and grounds."""
    box(d, BRIDGE, BRIDGE_RIGHT, BOTTOM, BRIDGE_TOP, "#f1ecf8")
    write(d, ((BRIDGE + BRIDGE_RIGHT) / 2, 6.9), b.name, LARGE)
    pin(d, (BRIDGE + 1.4, BRIDGE_TOP), "top", *b.logic)
    pin(d, (BRIDGE_RIGHT - 1.4, BRIDGE_TOP), "top", *b.supply)
    middle = (BRIDGE + BRIDGE_RIGHT) / 2
    for i, number in enumerate(b.grounds):
        x = middle + 1.2 * (i - (len(b.grounds) - 1) / 2)
        pin(d, (x, BOTTOM), "bottom", "GND", number)
        wire(d, (x, BOTTOM), (x, RAIL), dot=True)


def signals(d, b: Bridge) -> None:
    """Wires from the Pico to the bridge; the enables have pull-downs, or every input if there are none."""
    for name, color, y, pico_pin, pico_number, bridge_pin, bridge_number in b.signals:
        pin(d, (PICO_RIGHT, y), "right", pico_pin, pico_number)
        pin(d, (BRIDGE, y), "left", bridge_pin, bridge_number)
        wire(d, (PICO_RIGHT, y), (BRIDGE, y), color=color)
        write(d, (13.2, y + 0.32), name, NORMAL, color)
    if b is DRV8833:
        for i, (_, _, y, *_) in enumerate(b.signals):
            d += elm.Resistor().at((PULL_DOWN, y)).to((PULL_DOWN, y - 1.3)).idot()
            d += elm.Ground().at((PULL_DOWN, y - 1.3)).theta(0)
            write(d, (PULL_DOWN - 0.4, y - 0.75), f"R{i + 1}  {b.pull_down}", align="right")
        return
    wire(d, (PICO_RIGHT, GND_3), (LOGIC_CAPACITOR if b is SN754410 else PULL_DOWN, GND_3))
    for name, y, to_ground in (("R1", b.signals[0][2], GND_3), ("R2", b.signals[-1][2], RAIL)):
        d += elm.Resistor().at((PULL_DOWN, y)).to((PULL_DOWN, to_ground)).idot()
        write(d, (PULL_DOWN - 0.4, (y + to_ground) / 2), f"{name}\n{b.pull_down}", align="right")
    d += elm.Dot().at((PULL_DOWN, RAIL))


def motors(d, b: Bridge) -> None:
    """The motors between the bridge's outputs."""
    for capacitor, (words, color), (upper, lower) in zip(("C4", "C5"), MOTORS, b.outputs, strict=True):
        for name, number, y in (upper, lower):
            pin(d, (BRIDGE_RIGHT, y), "right", name, number)
            wire(d, (BRIDGE_RIGHT, y), (MOTOR, y), color=color)
        d += elm.Capacitor().at((MOTOR - 0.85, upper[2])).to((MOTOR - 0.85, lower[2])).color(color)
        write(d, (MOTOR - 0.95, (upper[2] + lower[2]) / 2 + 0.7), f"{capacitor}\n100 nF", SMALL, color, align="right")
        d += elm.Motor().at((MOTOR, upper[2])).to((MOTOR, lower[2])).color(color)
        write(d, (MOTOR, (upper[2] + lower[2]) / 2), "M", NORMAL, color)
        write(d, (MOTOR + 0.8, (upper[2] + lower[2]) / 2), words, NORMAL, color, align="left")


def switches(d, _b: Bridge) -> None:
    """Normally closed switches from the Pico's inputs to ground."""
    for name, color, y, pico_pin, number in SWITCHES:
        pin(d, (PICO, y), "left", pico_pin, number)
        d += elm.Button(nc=True).at((0, y)).to((PICO, y)).color(color)
        write(d, (1.5, y + 0.35), name, NORMAL, color)
        d += elm.Dot().at((0, y))
    name, y, pico_pin, number = EMERGENCY_STOP
    pin(d, (PICO, y), "left", pico_pin, number)
    d += elm.Button(nc=True).at((0, y)).to((PICO, y)).color(ORANGE)
    write(d, (1.4, y + 0.35), name, SMALL, ORANGE)
    d += elm.Dot().at((0, y))
    wire(d, (0, SWITCHES[0][2]), (0, RAIL))
    words = "End-stop switches (optional),\nnormally closed;\npull-ups are in the Pico"
    write(d, (2.6, 12.2), words, SMALL, GREY)


def supply(d, _b: Bridge) -> None:
    """The common ground; the motors' own supply with what protects and stops it; the capacitors at the bridge."""
    d += elm.Line().at((0, RAIL)).to((SOURCE, RAIL)).linewidth(3.5)
    d += elm.Ground().at((PULL_DOWN - 2.5, RAIL)).theta(0)
    write(d, (PULL_DOWN - 3.2, RAIL - 0.55), "common ground", align="right")
    x = BRIDGE_RIGHT - 1.4
    wire(d, (x, BRIDGE_TOP), (x, SUPPLY), (DIODE, SUPPLY), color=ORANGE)
    d += elm.Schottky().at((BUTTON, SUPPLY)).to((DIODE, SUPPLY)).color(ORANGE)
    d += elm.Button(nc=True).at((BUTTON, SUPPLY)).to((SWITCH, SUPPLY)).color(ORANGE)
    d += elm.Switch().at((SWITCH, SUPPLY)).to((FUSE, SUPPLY)).color(ORANGE)
    d += elm.Fuse().at((FUSE, SUPPLY)).to((SOURCE, SUPPLY)).color(ORANGE)
    labels = ((DIODE, "D9\n1N5822"), (BUTTON, "emergency\nstop"), (SWITCH, "motor\npower"), (FUSE, "F1\n1 A"))
    for start, words in labels:
        write(d, (start + 1.5, SUPPLY + 1.3), words, NORMAL, ORANGE)
    d += elm.Capacitor().at((SMALL_CAPACITOR, SUPPLY)).to((SMALL_CAPACITOR, RAIL)).dot().idot()
    d += elm.Capacitor(polar=True).at((BULK_CAPACITOR, SUPPLY)).to((BULK_CAPACITOR, RAIL)).dot().idot()
    write(d, (SMALL_CAPACITOR - 0.5, 8.2), "C1\n100 nF", align="right")
    write(d, (BULK_CAPACITOR + 0.5, 8.2), "C2\n100 µF", align="left")
    d += elm.Battery().at((SOURCE, SUPPLY)).to((SOURCE, RAIL))
    write(d, (SOURCE - 0.6, 7.25), "+\n\n\n-")
    write(d, (SOURCE - 0.7, 5.3), "motor supply\nabout 6 V DC\nnot the USB 5 V", align="right")


def clamps(d, b: Bridge) -> None:
    """The two diodes of an output of the SN754410, drawn once for all four."""
    if b is not SN754410:
        return
    x, y = CLAMPS
    d += elm.Schottky().at((x, y)).to((x, y + 2.5)).color(ORANGE)
    d += elm.Schottky().at((x, y - 2.5)).to((x, y)).color(ORANGE)
    wire(d, (x - 2, y), (x + 2, y), color=BLUE)
    d += elm.Dot().at((x, y)).color(BLUE)
    write(d, (x - 2.2, y), "1Y", align="right")
    write(d, (x + 2.2, y), "to the motor", align="left")
    write(d, (x, y + 2.9), "VCC2, pin 8", color=ORANGE)
    write(d, (x, y - 2.9), "common ground")
    write(d, (x + 0.6, y + 1.3), "D1", align="left")
    write(d, (x + 0.6, y - 1.3), "D2", align="left")
    write(d, (x, PINOUT[1] + 0.6), "The same at 2Y, 3Y and 4Y:\nD1 to D8, 1N5819")


def noise(d, _b: Bridge) -> None:
    """The three capacitors of a motor, drawn once for both."""
    x, y = NOISE
    box(d, x - 1, x + 1, y - 1.3, y + 1.3, "#eeeeee")
    d += elm.Motor().at((x, y + 2)).to((x, y - 2)).color(BLUE)
    write(d, (x, y), "M", NORMAL, BLUE)
    for end in (y + 2, y - 2):
        wire(d, (x - 2.8, end), (x, end), color=BLUE)
        wire(d, (x, end), (x + 1.9, end), color=BLUE)
        d += elm.Capacitor().at((x + 1.9, end)).to((x + 1.9, y)).color(BLUE)
        d += elm.Dot().at((x, end)).color(BLUE)
        write(d, (x + 2.4, (end + y) / 2), "100 nF", SMALL, align="left")
    d += elm.Dot().at((x - 1.9, y + 2)).color(BLUE)
    d += elm.Capacitor().at((x - 1.9, y + 2)).to((x - 1.9, y - 2)).dot().color(BLUE)
    write(d, (x - 2.4, y), "C4\n100 nF", SMALL, align="right")
    wire(d, (x + 1.9, y), (x + 1, y), color=BLUE, dot=True)
    write(d, (x, y - 2.9), "grey: the motor's case")
    write(d, (x, PINOUT[1] + 0.6), "Each motor,\nas short as can be")


def legend(d, b: Bridge) -> None:
    """The package of an SN754410 from above, to count pins by; and what lines cannot say."""
    left, top = PINOUT
    if b is SN754410:
        names = {number: name for name, number in (b.logic, b.supply)} | dict.fromkeys(b.grounds, "GND")
        names |= {number: name for *_, name, number in b.signals}
        names |= {number: name for pair in b.outputs for name, number, _ in pair}
        sizes: dict[str, Any] = {"width": 5, "spacing": 0.3, "pinw": 0.5, "fontsize": NORMAL, "pfontsize": SMALL}
        d += elm.IcDIP(names=[names[i] for i in range(1, 17)], pins=16, **sizes).at((left, top - 7)).theta(0)
        write(d, (left + 2.5, top + 0.6), "SN754410 from above")
    lines = "".join(part.lstrip() for part in (NOTES[0], b.notes, NOTES[1])).splitlines()
    for i, words in enumerate(lines):
        write(d, (NOTES_AT[0], NOTES_AT[1] - 0.7 * i), words, align="left")


if __name__ == "__main__":
    main()
