"""The way out of the firmware on CircuitPython: whatever comes on it, no motor and no watchdog is left on."""

from mirrormount_sim import machines
from mirrormount_sim.simulation import Simulation

WAYS_OUT = """
import sys, usb_cdc, microcontroller
from watchdog import WatchDogMode
from mountfw.ports import circuitpython as pins
WAY_OUT = ("code.py", "ports/circuitpython.py", "ports/shared.py", "mountfw/boards/__init__.py")
seen = set()
count, delivered, leaving = 0, False, False

class App:
    def run(self):
        global leaving
        for out in pins._outputs.values():
            out.high()
        microcontroller.watchdog.mode = WatchDogMode.RESET
        leaving = True
        raise KeyboardInterrupt

def each_bytecode(frame, event, _arg):
    global count, delivered
    if event == "opcode" and leaving and not delivered:
        count += 1
        if count == second_at:
            delivered = True
            raise KeyboardInterrupt
    return each_bytecode

def trace(frame, _event, _arg):
    if not frame.f_code.co_filename.endswith(WAY_OUT):
        return None
    seen.update([name for name in WAY_OUT if frame.f_code.co_filename.endswith(name)])
    frame.f_trace_opcodes, frame.f_trace_lines = True, False
    return each_bytecode

code = compile(SOURCE, "code.py", "exec")
second_at, bad = 0, 0
while True:
    second_at += 1
    count, delivered, leaving = 0, False, False
    from mountfw import build
    build.build = lambda _port, _board: App()
    sys.settrace(trace)
    try:
        exec(code, {"__name__": "__main__", "print": lambda *_: None})
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(None)
    if not delivered:
        break
    on = [out for out in pins._outputs.values() if getattr(out.io, "_level", False) or getattr(out.io, "_duty", 0)]
    bad += len(on) + (microcontroller.watchdog.mode is not None)
    assert len(pins._outputs) == 6
    assert len(seen) == len(WAY_OUT)
usb_cdc.data.write_timeout = 0
usb_cdc.data.write(b"%d %d\\n" % (second_at, bad))
"""


def test_a_second_ctrl_c_anywhere_on_the_way_out_leaves_no_motor_and_no_watchdog_on(tmp_path, boards):
    code = (machines.firmware_folder() / "mountfw" / "entry" / "code.py").read_text()
    code = code.replace(
        "port.motors_off(board)", "[port.motors_off(board), port.output(2, 4000), port.output(5, 4000)]"
    )
    (tmp_path / "code.py").write_text(f"SOURCE = {code!r}\n{WAYS_OUT}")
    board = boards(Simulation(machines.circuitpython(tmp_path)))
    board.run(60_000_000, lambda: b"\n" in board.received)
    places, bad = (int(n) for n in board.received.split())
    assert bad == 0
    assert places > 30


def test_motors_off_takes_every_drive_pin_of_every_axis(new, tmp_path):
    program = "import usb_cdc\nfrom mountfw.boards import pico\nfrom mountfw.ports import circuitpython as port\n"
    program += "class Board:\n    AXIS_1 = pico.AXIS_1\n    AXIS_2 = pico.AXIS_2\n"
    program += "    AXIS_3 = {'en': 16, 'pos': 17, 'neg': 18, 'stop_pos': 19, 'stop_neg': None}\n"
    program += "port.motors_off(Board)\n"
    program += "usb_cdc.data.write(b'%s\\n' % ' '.join([str(pin) for pin in sorted(port._outputs)]).encode())\n"
    (tmp_path / "code.py").write_text(program)
    board = new()
    board.run(3_000_000, lambda: b"\n" in board.received)
    assert bytes(board.received) == b"2 3 4 5 6 7 16 17 18\n"
