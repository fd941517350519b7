"""One place of the firmware turns a motor on: read from its source, and seen by who calls a bridge."""

import ast
import sys
from pathlib import Path

from rig import Rig

import mountfw
from mountfw.ports.bridges import EnableBridge

FOLDER = Path(mountfw.__file__).parent


def calls(verbs: set[str]) -> set[tuple[str, str, str]]:
    """(file, function, verb) of each call of a method of these names."""
    found = set()
    for path in sorted(FOLDER.rglob("*.py")):
        for function in ast.walk(ast.parse(path.read_text())):
            if not isinstance(function, ast.FunctionDef):
                continue
            for node in ast.walk(function):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in verbs:
                    found.add((str(path.relative_to(FOLDER)), function.name, node.func.attr))
    return found


def test_one_function_calls_a_bridge_to_drive():
    assert calls({"drive"}) == {("motion/drive.py", "_set", "drive")}


def test_one_class_calls_that_function_and_after_its_gate():
    assert calls({"_set"}) == {("motion/drive.py", "on", "_set"), ("motion/drive.py", "begin", "_set")}


def test_the_fast_lane_has_one_function_that_drives_and_two_call_it():
    tree = ast.parse((FOLDER / "ports" / "rp2_lane.py").read_text())
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    callers = {
        function.name
        for function in functions
        for node in ast.walk(function)
        if isinstance(node, ast.Name) and node.id == "_drive"
    }
    assert callers == {"drive", "_obeyed"}  # of the bridge, which _set() calls; and of the lane
    raising = [f.name for f in functions if any(isinstance(n, ast.Name) and n.id == "_OUT_SET" for n in ast.walk(f))]
    assert raising == ["_drive"]


def test_only_bridges_raise_an_output():
    found = {
        call
        for call in calls({"high", "level"})
        if not call[0].startswith(("ports/micropython", "ports/circuitpython", "ports/rp2"))
    }
    bridges = "ports/bridges.py"
    assert found == {(bridges, "drive", "high"), (bridges, "_carry", "high"), (bridges, "_carry", "level")}
    tree = ast.parse((FOLDER / bridges).read_text())
    callers = {
        function.name
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        for node in ast.walk(function)
        if isinstance(node, ast.Name) and node.id == "_carry"
    }
    assert callers == {"drive"}


def test_whatever_moves_an_axis_comes_by_that_function(monkeypatch):
    real, callers = EnableBridge.drive, []

    def drive(bridge, duty):
        callers.append(sys._getframe(1).f_code.co_qualname)
        return real(bridge, duty)

    monkeypatch.setattr(EnableBridge, "drive", drive)
    for command in (b"1PR1\n", b"1PA1\n", b"1XU300\n", b"1MV+\n", b"1MT+\n", b"1OR\n", b"02550255"):
        rig = Rig()
        rig.port.switches.update({10: 0, 11: 0})
        rig.ask(b"1XL3\n")
        callers.clear()
        rig.ask(command)
        assert callers and set(callers) == {"Drive._set"}, command
