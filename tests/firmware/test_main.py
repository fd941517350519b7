"""The ways out, of start.py and of a move at the prompt: two Ctrl-C, the second before every bytecode."""

import contextlib
import io
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from rig import Rig

import mountfw.ports.shared
from mountfw.boards import pico

START = Path(mountfw.__file__).parent / "start.py"
PORT = Path(mountfw.__file__).parent / "ports" / "micropython.py"
SHARED = {str(PORT.parent / "shared.py"), str(PORT.parent.parent / "boards" / "__init__.py")}
WAY_OUT = {str(START), str(PORT)} | SHARED
WATCHDOG_OFF = 0x40058000 + 0x3000  # RP2040: where a write clears bits of its control register
SCRATCH4 = 0x40058000 + 0x1C  # says, if it is not 0, that a reset would be the watchdog's own
OFF_AND_UNMARKED = {WATCHDOG_OFF: 1 << 30, SCRATCH4: 0}
DRIVES = [board[name] for board in (pico.AXIS_1, pico.AXIS_2) for name in ("en", "pos", "neg")]


class Levels(dict):
    """What the pins show; and the smallest `machine.Pin` that motors_off of ports/micropython.py needs."""

    OUT = 1
    ALT = 3
    ALT_PWM = 4

    def __call__(self, number, _mode, value):
        self[number] = value


@pytest.fixture
def port(monkeypatch):
    """The port on a Pico."""
    return make_port(monkeypatch, "Raspberry Pi Pico with RP2040")


def make_port(monkeypatch, machine):
    """The real ports/micropython.py, of which the way out and the watchdog are used, on stand-ins for the hardware.

    machine: what MicroPython calls the board.
    """
    levels = Levels()
    state = SimpleNamespace(levels=levels, interrupt_char=3, registers={})
    fakes = {
        "machine": {
            "Pin": levels,
            "PWM": None,
            "WDT": lambda timeout: SimpleNamespace(feed=timeout),
            "mem32": state.registers,
        },
        "micropython": {"kbd_intr": lambda char: setattr(state, "interrupt_char", char)},
        "mountfw.ports.micropython_console": dict.fromkeys(("any", "drain", "pack", "writable", "write")),
        "mountfw.ports.micropython_encoder": {"reader": None},
        "time": {"ticks_us": None, "ticks_ms": None, "sleep_us": None},
        "sys": {"implementation": SimpleNamespace(_machine=machine)},
    }
    module = ModuleType("mountfw.ports.micropython")
    with monkeypatch.context() as patch:
        for name, attributes in fakes.items():
            fake = ModuleType(name)
            vars(fake).update(attributes)
            patch.setitem(sys.modules, name, fake)
        exec(compile(PORT.read_text(), str(PORT), "exec"), vars(module))
    module.find_board = lambda: pico
    module.state = state
    monkeypatch.setitem(sys.modules, "mountfw.ports.micropython", module)
    monkeypatch.setattr(mountfw.ports, "micropython", module, raising=False)
    return module


def run_start(port, second_at: int) -> bool:
    """Run start.py with Ctrl-C in the loop and again before the second_at-th bytecode of the way out.

    False if the way out has fewer.
    """
    count, delivered, leaving = 0, False, False
    seen = set()

    class App:
        def run(self):
            nonlocal leaving
            port.start_watchdog()
            for pin in DRIVES:
                port.state.levels[pin] = 1
            leaving = True
            raise KeyboardInterrupt

    def each_bytecode(frame, event, _arg):
        nonlocal count, delivered
        if event == "opcode" and leaving and not delivered and port.state.interrupt_char == 3:
            count += 1
            if count == second_at:
                delivered = True
                raise KeyboardInterrupt
        return each_bytecode

    def trace(frame, _event, _arg):
        if frame.f_code.co_filename not in WAY_OUT:
            return None
        seen.add(frame.f_code.co_filename)
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        return each_bytecode

    from mountfw import build

    real, build.build = build.build, lambda _port, _board: App()
    code = compile(START.read_text(), str(START), "exec")
    sys.settrace(trace)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(KeyboardInterrupt):
            exec(code, {"__name__": "mountfw.start"})
    finally:
        sys.settrace(None)
        build.build = real
    assert seen == WAY_OUT
    return delivered


def test_a_second_ctrl_c_anywhere_on_the_way_out_leaves_no_motor_on(port):
    places = 0
    while run_start(port, places + 1):
        places += 1
        assert [port.state.levels[pin] for pin in DRIVES] == [0] * 6, f"Ctrl-C before bytecode {places}"
        assert port.state.registers == OFF_AND_UNMARKED, f"the watchdog runs on; Ctrl-C before bytecode {places}"
        port.state.registers.clear()
    assert places > 30


@pytest.mark.parametrize(
    ("machine", "control"),
    [
        ("Raspberry Pi Pico with RP2040", 0x40058000),
        ("Raspberry Pi Pico 2 with RP2350", 0x400D8000),
        ("Raspberry Pi Pico 2 with RP2350-RISCV", 0x400D8000),
        ("Generic ESP32 module with ESP32", None),
    ],
)
def test_each_chip_whose_watchdog_can_be_stopped_has_one_on_either_kind_of_core(monkeypatch, machine, control):
    port = make_port(monkeypatch, machine)
    armed = port.start_watchdog() == 1000  # ms
    port.stop_watchdog()
    assert armed == (control is not None)
    assert port.state.registers == ({control + 0x3000: 1 << 30, control + 0x1C: 0} if control else {})


def test_motors_off_puts_every_drive_pin_of_every_axis_low_the_enables_first(port):
    third = {"en": 16, "pos": 17, "neg": 18, "stop_pos": 19, "stop_neg": None}
    port.motors_off(SimpleNamespace(AXIS_1=pico.AXIS_1, AXIS_2=pico.AXIS_2, AXIS_3=third))
    assert list(port.state.levels.items()) == [(pin, 0) for pin in (2, 5, 16, 3, 6, 17, 4, 7, 18)]


def move_at_the_prompt(port, second_at: int) -> tuple[bool, Rig]:
    """A step at the prompt with Ctrl-C in mid-pulse and again before the second_at-th bytecode of the way out.

    Returns whether the way out has that many, and the board.
    """
    count, delivered, leaving = 0, False, False
    rig = Rig()
    folder = Path(mountfw.__file__).parent
    motion = (f"motion/{name}.py" for name in ("controller", "axis", "drive"))
    files = {str(PORT), *(str(folder / name) for name in ("repl.py", "ports/bridges.py", *motion))}
    assert all(Path(file).is_file() for file in files)

    def pause_us(us):
        nonlocal leaving
        if us > 100 and rig.now() > 50_000:
            assert rig.drives() == (255, 0)
            leaving = True
            raise KeyboardInterrupt
        rig.port.pause_us(us)

    def each_bytecode(frame, event, _arg):
        nonlocal count, delivered
        if event == "opcode" and leaving and not delivered and port.state.interrupt_char == 3:
            count += 1
            if count == second_at:
                delivered = True
                raise KeyboardInterrupt
        return each_bytecode

    def trace(frame, _event, _arg):
        if frame.f_code.co_filename not in files:
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        return each_bytecode

    port.ticks_us, port.pause_us = rig.port.ticks_us, pause_us
    from mountfw import repl

    mount = repl.Mount(port, rig.app)
    sys.settrace(trace)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            mount.y.step(1)
    finally:
        sys.settrace(None)
    return delivered, rig


def test_a_second_ctrl_c_anywhere_on_the_way_out_of_a_move_at_the_prompt_leaves_no_motor_on(port, monkeypatch):
    port.ticks_us = port.ticks_ms = lambda: 0
    Rig()  # there is a firmware to go on with
    monkeypatch.delitem(sys.modules, "mountfw.repl", raising=False)
    places = 0
    while True:
        delivered, rig = move_at_the_prompt(port, places + 1)
        if not delivered:
            break
        places += 1
        assert not any(rig.port.pins.values()), f"Ctrl-C before bytecode {places}"
        assert port.state.interrupt_char == 3
    assert not any(rig.port.pins.values())
    assert places > 30
