"""Every port has the verbs of port_protocol.py, with the same arity, and the core uses no other."""

import ast
import importlib
import inspect
import sys
import time
import types
from pathlib import Path

import port_protocol
import pytest
import rig

import mountfw

FIRMWARE = Path(mountfw.__file__).parent
CORE = ("app.py", "build.py", "store.py", "repl.py")
Arity = tuple[int, int]  # the fewest and the most arguments


@pytest.fixture
def reader_of(monkeypatch):
    """The readers of MicroPython's port, on a chip without PIO; reader_of(bus): with this I2C."""

    def reader_of(bus):
        machine = types.ModuleType("machine")
        machine.Pin, machine.I2C = int, bus  # pyright: ignore[reportAttributeAccessIssue]
        for name in [n for n in sys.modules if n in ("rp2", "machine") or n.endswith(".micropython_encoder")]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, "machine", machine)
        monkeypatch.setitem(sys.modules, "rp2", None)
        reader = importlib.import_module("mountfw.ports.micropython_encoder").reader
        monkeypatch.delitem(sys.modules, "mountfw.ports.micropython_encoder")
        return reader

    return reader_of


def test_a_sensor_that_is_gone_is_asked_twice_a_second_and_is_there_again_when_it_answers(reader_of, monkeypatch):
    class Bus:
        answers, asked = True, 0

        def __init__(self, _number, **_options):
            pass

        def readfrom_mem_into(self, _address, _register, answer):
            Bus.asked += 1
            if not Bus.answers:
                raise OSError(5)
            answer[:] = b"\x20\x01\x00"

    now_ms = 0
    monkeypatch.setattr(time, "ticks_ms", lambda: now_ms, raising=False)
    monkeypatch.setattr(time, "ticks_diff", lambda later, earlier: later - earlier, raising=False)
    reader = reader_of(Bus)(1, {"shaft": (8, 9)})
    assert reader.counts() == 256 and not reader.gone
    Bus.answers, Bus.asked = False, 0
    for now_ms in range(0, 10_000, 10):  # noqa: B007 (the clock reads it)
        reader.counts()
    assert reader.gone and Bus.asked == 3 + 19
    Bus.answers = True
    now_ms += 500
    reader.counts()
    assert not reader.gone


def test_a_stop_waits_2_ms_at_most_for_an_as5600_whose_bus_hangs(reader_of):
    asked = {}

    class Bus:
        readfrom_mem_into = None

        def __init__(self, _number, **options):
            asked.update(options)

    reader_of(Bus)(1, {"shaft": (8, 9)})
    assert asked["timeout"] == 2_000  # us; MicroPython's own is 50 ms


def test_every_bridge_has_the_verbs_of_a_bridge():
    classes = {
        node.name + path.name: node
        for path in (FIRMWARE / "ports").glob("*.py")
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.ClassDef) and node.name.endswith("Bridge")
    }
    assert len(classes) >= 5
    base = classes.pop("Bridgebridges.py")  # the one that others extend
    of_base = {f.name for f in base.body if isinstance(f, ast.FunctionDef)}
    for name, node in classes.items():
        own = {f.name for f in node.body if isinstance(f, ast.FunctionDef)}
        own |= {a.attr for a in ast.walk(node) if isinstance(a, ast.Attribute) and isinstance(a.ctx, ast.Store)}
        own |= of_base if node.bases else set()
        assert own >= {"cut", "cut_at", "release", "drive"}, name
        assert "tune" in own or "circuitpython" in name, name  # that port is not TUNABLE


def arity_of(arguments: ast.arguments) -> Arity:
    assert not (arguments.vararg or arguments.kwarg or arguments.kwonlyargs)
    most = len(arguments.posonlyargs) + len(arguments.args)
    return most - len(arguments.defaults), most


def verbs_of(protocol: type) -> dict[str, Arity]:
    found = {}
    for name, method in inspect.getmembers(protocol, inspect.isfunction):
        if not name.startswith("_"):
            needed = list(inspect.signature(method).parameters.values())[1:]
            found[name] = (sum(p.default is p.empty for p in needed), len(needed))
    return found


def public_functions(path: Path) -> dict[str, Arity | None]:
    """Name to arity of a module's public functions, its own and those that it takes from other modules of ours.

    None is the arity of a function that is only given a name here, as `rename = os.rename`.
    """
    found: dict[str, Arity | None] = {}
    body = ast.parse(path.read_text()).body
    body += [node for choice in body if isinstance(choice, ast.If) for node in choice.body + choice.orelse]
    for node in body:
        if isinstance(node, ast.FunctionDef):
            found[node.name] = arity_of(node.args)
        elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Attribute):
            found |= {target.id: None for target in node.targets if isinstance(target, ast.Name)}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mountfw."):
            there = FIRMWARE.joinpath(*(node.module or "").split(".")[1:]).with_suffix(".py")
            if there.exists():
                functions = public_functions(there)
                found |= {alias.name: functions[alias.name] for alias in node.names if alias.name in functions}
    return {name: arity for name, arity in found.items() if not name.startswith("_")}


VERBS = verbs_of(port_protocol.Port)
ENTRY_VERBS = verbs_of(port_protocol.EntryPort)
OPTIONAL = verbs_of(port_protocol.OptionalVerbs)
GIVEN = {"ticks_us", "ticks_ms", "pause_us", "rename"}  # the platform's own functions under a verb's name


def test_the_protocol_has_the_verbs_of_the_loop_and_of_the_entry_files():
    assert {"any", "drain", "output", "load", "uninterrupted"} <= VERBS.keys()
    assert ENTRY_VERBS.keys() - VERBS.keys() == {"find_board", "motors_off", "leave"}
    assert VERBS["output"] == (1, 2) and VERBS["drain"] == (2, 2) and VERBS["collect"] == (0, 0)


@pytest.mark.parametrize("name", ["micropython", "circuitpython"])
def test_a_port_has_these_verbs_and_no_others(name):
    functions = public_functions(FIRMWARE / "ports" / f"{name}.py")
    assert functions.keys() - OPTIONAL.keys() == ENTRY_VERBS.keys()
    assert {verb: functions[verb] for verb in functions.keys() & OPTIONAL.keys()}.items() <= OPTIONAL.items()
    functions = {verb: arity for verb, arity in functions.items() if verb in ENTRY_VERBS}
    given = {verb for verb, arity in functions.items() if arity is None}
    assert given <= GIVEN
    assert {verb: functions[verb] for verb in functions.keys() - given} == {
        verb: arity for verb, arity in ENTRY_VERBS.items() if verb not in given
    }


def test_the_rigs_port_has_these_verbs():
    port: port_protocol.Port = rig.Port()  # the type checker compares the types, too
    for name, (least, most) in VERBS.items():
        parameters = inspect.signature(getattr(port, name)).parameters.values()
        assert (sum(p.default is p.empty for p in parameters), len(parameters)) == (least, most), name


@pytest.mark.parametrize("name", CORE)
def test_the_core_uses_no_other_verb(name):
    used = {
        node.attr
        for node in ast.walk(ast.parse((FIRMWARE / name).read_text()))
        if isinstance(node, ast.Attribute)
        and (
            (isinstance(node.value, ast.Name) and node.value.id == "port")
            or (isinstance(node.value, ast.Attribute) and node.value.attr in ("port", "_port"))
        )
    }
    assert used
    assert used - ENTRY_VERBS.keys() - OPTIONAL.keys() == set()
