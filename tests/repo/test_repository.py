"""Facts about the files of this repository."""

import ast
import json
import re
import tomllib
from pathlib import Path

from mirrormount_sim.bench import DRIVES, SWITCHES
from mountfw.boards import pico, pico_drv8833

ROOT = Path(__file__).parent.parent.parent
FIRMWARE = ROOT / "firmware_py" / "mountfw"
HOST = ROOT / "host"

# A port's files and the entry files name a platform. Of what is not ours, the rest may name these alone, which both
# platforms have: checksums; the two tick functions if there are any; the interpreter's name and its modules. Nothing
# else, be it of one platform (machine, rp2, board, pwmio) or different on each (micropython, os, gc, select, hashlib).
PORTS = ("micropython", "circuitpython", "rp2_")
ON_BOTH_PLATFORMS = {"settings": {"binascii"}, "lane": {"array"}, "ticks": {"time"}, "repl": {"sys"}}
MICROPYTHON_ONLY = {"machine", "micropython", "rp2", "esp32", "vfs"}
CIRCUITPYTHON_ONLY = {"board", "digitalio", "pwmio", "usb_cdc", "supervisor", "microcontroller", "storage", "watchdog"}
CIRCUITPYTHON_ONLY |= {"adafruit_motor", "nvm", "rp2pio", "analogio", "countio", "busio"}


def imported(path: Path) -> set[str]:
    """Every module that a file names in an import, those inside functions included."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            names |= {f"{module}.{alias.name}" for alias in node.names} | {module}
    return names


def test_only_the_ports_name_a_platform_inside_functions_too():
    started = [p for p in FIRMWARE.rglob("*.py") if p.name != "start.py" and p.parent.name != "entry"]
    shared = [p for p in started if not p.name.startswith(PORTS)]
    assert len(shared) > 20
    for path in shared:
        theirs = {n.split(".")[0] for n in imported(path)} - {"mountfw", ""}
        assert theirs <= ON_BOTH_PLATFORMS.get(path.stem, set()), path
        ours = {n for n in imported(path) if n.startswith("mountfw.")}
        assert not any(n.startswith(tuple(f"mountfw.ports.{name}" for name in PORTS)) for n in ours), path


def test_no_port_names_the_other_ones_platform():
    entries = {"main.py": CIRCUITPYTHON_ONLY, "boot.py": MICROPYTHON_ONLY, "code.py": MICROPYTHON_ONLY}
    for path in FIRMWARE.rglob("*.py"):
        foreign = entries.get(path.name, set()) if path.parent.name == "entry" else set()
        if path.name.startswith(PORTS):
            foreign = MICROPYTHON_ONLY if path.name.startswith("circuitpython") else CIRCUITPYTHON_ONLY
        assert not {n.split(".")[0] for n in imported(path)} & foreign, path


def test_what_is_shared_uses_nothing_that_circuitpython_lacks():
    for path in FIRMWARE.rglob("*.py"):
        if path.name.startswith(("micropython", "rp2_")) or path.name in ("main.py", "start.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            name = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
            assert name not in {"native", "viper", "ptr8", "ptr32", "kbd_intr", "heap_lock", "schedule", "sleep_us"}, (
                path
            )
            assert not isinstance(node, ast.Match | ast.AsyncFunctionDef | ast.NamedExpr), path


def test_the_host_takes_only_the_wire_from_the_firmware():
    allowed = {"mountfw", "mountfw.__version__", "mountfw.codes", "mountfw.settings"}
    allowed |= {"mountfw.board_file", "mountfw.settings.MAX_STEPS"}
    wire = ("mountfw.wire.frame", "mountfw.dialect.line", "mountfw.wire.receiver")  # the grammar
    for path in HOST.rglob("*.py"):
        if "fakes" not in path.parts and "fakes_circuitpython" not in path.parts:
            taken = {n for n in imported(path) if n.split(".")[0] == "mountfw" and not n.startswith(wire)}
            assert taken <= allowed, path


def test_the_bench_imports_nothing_of_the_firmware():
    for name in ("beams", "bench", "mechanics", "optics"):
        assert not {n for n in imported(HOST / "mirrormount_sim" / f"{name}.py") if n.startswith("mountfw")}


def test_package_json_lists_exactly_what_goes_to_a_micropython_board():
    package = json.loads((FIRMWARE / "package.json").read_text())
    files = [p for p in FIRMWARE.rglob("*.py") if not p.name.startswith("circuitpython")]
    library = {p.relative_to(FIRMWARE).as_posix() for p in files if p.parent.name != "entry"}
    assert package["urls"][-1] == ["main.py", "entry/main.py"]  # an install that is cut short starts nothing
    assert {tuple(pair) for pair in package["urls"]} == {(f"mountfw/{f}", f) for f in library} | {
        ("main.py", "entry/main.py")
    }
    assert package["version"] == __import__("mountfw").__version__


def test_the_bench_is_wired_as_the_board_files_say():
    for board in (pico, pico_drv8833):
        for axis, pins in ((1, board.AXIS_1), (2, board.AXIS_2)):
            for name in ("en", "pos", "neg"):
                assert pins[name] is None or DRIVES[pins[name]] == f"m{axis}_{name}"
            for name in ("pos", "neg"):
                assert SWITCHES[pins[f"stop_{name}"]] == f"m{axis}_sw_{name}"


def test_relative_links_of_the_documents_lead_somewhere():
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)[^)]*\)", path.read_text()):
            if "://" not in target:
                assert (path.parent / target).exists(), f"{path.name}: {target}"


def test_both_packages_say_that_they_are_typed():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    for package in project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]:
        assert (ROOT / package / "py.typed").is_file()


def test_the_files_that_contributing_names_are_there():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    names = re.findall(r"`((?:docs|firmware_py|host|tests|tools|\.ci)/[\w/.-]*)`", text)
    assert len(names) > 20
    for name in names:
        assert (ROOT / name).exists(), name


def test_contributing_lists_every_folder_of_tests():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    folders = {p.name for p in (ROOT / "tests").iterdir() if p.is_dir() and any(p.glob("test_*.py"))}
    assert {name for name in folders if f"`tests/{name}`" in text} == folders


def test_the_hooks_before_a_commit_fetch_nothing():
    text = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    assert re.findall(r"repo: (.*)", text) == ["local"]
    assert set(re.findall(r"language: (.*)", text)) == {"system"}
