"""The drawing of the wiring, the table beside it and the board file tell the same pins."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest

from mirrormount_sim.bench import ENCODERS
from mountfw.boards import pico, pico_drv8833

ROOT = Path(__file__).resolve().parents[2]
PHYSICAL = {
    2: 4,
    3: 5,
    4: 6,
    5: 7,
    6: 9,
    7: 10,
    10: 14,
    11: 15,
    12: 16,
    13: 17,
    14: 19,
    8: 11,
    9: 12,
    26: 31,
    27: 32,
    28: 34,
}  # of a Pico, by its GPIO
STOP = "emergency_stop"  # what GP14 is for, once a board file says so


@pytest.fixture(scope="module")
def wiring():
    """tools/wiring.py as a module."""
    spec = importlib.util.spec_from_file_location("mirrormount_tools_wiring", ROOT / "tools" / "wiring.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def board_file(board=pico) -> dict[str, int]:
    """Each signal's GPIO, by the names that the drawing uses."""
    names = {"en": "en", "pos": "pos", "neg": "neg", "stop_pos": "sw_pos", "stop_neg": "sw_neg"}
    axes = {1: board.AXIS_1, 2: board.AXIS_2}
    pins = {f"m{n}_{shown}": axis[name] for n, axis in axes.items() for name, shown in names.items()}
    return {name: pin for name, pin in pins.items() if pin is not None}


@pytest.mark.parametrize(("bridge", "board"), [("SN754410", pico), ("TB6612", pico), ("DRV8833", pico_drv8833)])
def test_a_drawing_shows_the_pins_of_its_board_file(wiring, bridge, board):
    drawn = {row[0]: (row[3], row[4]) for row in (*getattr(wiring, bridge).signals, *wiring.SWITCHES)}
    drawn[wiring.EMERGENCY_STOP[0]] = wiring.EMERGENCY_STOP[2:]
    pins = board_file(board) | {STOP: 14}
    assert drawn == {name: (f"GP{pin}", PHYSICAL[pin]) for name, pin in pins.items()}


def test_the_table_of_the_page_has_the_pins_of_the_board_file(wiring):
    text = (
        (ROOT / "docs" / "bring-up.md")
        .read_text(encoding="utf-8")
        .split("## 2. Wiring")[1]
        .split("**With a DRV8833**")[0]
    )
    told = {}
    for bridge, gpios, numbers, what in re.findall(
        r"^\| \S+ \| ([^|]+) \| (GP[^|]+) \| ([^|]+) \| (.*) \|$", text, re.M
    ):
        names = re.findall(r"`(\w+)`", what)
        for name, gpio, number in zip(names, gpios.split(", "), numbers.split(", "), strict=True):
            told[name] = (gpio, int(number), bridge.split(" ")[0])
    at_bridge = {row[0]: str(row[6]) for row in wiring.SN754410.signals}
    encoders = {
        f"{motor}_enc_{word}": pin for motor, pins in ENCODERS.items() for word, pin in zip("ab", pins, strict=True)
    }
    pins = board_file() | {STOP: 14, "POWER": pico.POWER} | encoders
    assert told == {name: (f"GP{pin}", PHYSICAL[pin], at_bridge.get(name, "–")) for name, pin in pins.items()}


@pytest.mark.parametrize("bridge", ["TB6612", "DRV8833"])
def test_a_carriers_drawing_has_the_wires_of_the_page(wiring, bridge):
    text = (ROOT / "docs" / "bring-up.md").read_text(encoding="utf-8")
    head, _, row = re.findall(r"^\|.*$", text.split(f"**With a {bridge}**")[1], re.M)[:3]
    names, ends = ([cell.strip() for cell in line.strip("|").split("|")] for line in (head, row))
    told = dict(zip(names, ends, strict=True))
    b = getattr(wiring, bridge)
    assert all(told[row[5]] == f"{row[3]} `{row[0]}`" for row in b.signals)
    outputs = {", ".join(name for name, *_ in pair): f"motor {n}" for n, pair in enumerate(b.outputs, 1)}
    assert outputs.items() <= told.items()
    assert told[b.supply[0]] == "motor supply +" and told[b.logic[0]] == "3.3 V"


def test_the_drawings_are_what_the_tool_draws(wiring, monkeypatch, tmp_path):
    monkeypatch.setattr(wiring, "IMAGES", tmp_path)
    wiring.main()
    names = {"wiring.svg", "wiring-tb6612.svg", "wiring-drv8833.svg"}
    assert {path.name for path in tmp_path.glob("*.svg")} == names
    for name in names:
        assert (tmp_path / name).read_bytes() == (ROOT / "docs" / "images" / name).read_bytes()
