"""No program of this package runs Python files of the current folder, whatever their names (for repl: test_repl.py)."""

import ast
import subprocess
from pathlib import Path

import pytest
from served import SCRIPT, set_traps

from mirrormount.errors import EmulatorMissing
from mirrormount.terminal import python_module
from mirrormount_sim import machines

ROOT = Path(__file__).parent.parent.parent


def run_there(folder: Path, *command: str | Path) -> subprocess.CompletedProcess:
    """A command in that folder."""
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=600, stdin=subprocess.DEVNULL, check=False
    )


@pytest.fixture
def traps(tmp_path) -> Path:
    return set_traps(tmp_path / "traps")


def vm_is_there() -> None:
    try:
        machines.micropython(Path())
    except EmulatorMissing as e:
        pytest.skip(str(e))


@pytest.mark.full
def test_deploy_and_undeploy_run_the_installed_mpremote(serve, tmp_path, traps):
    vm_is_there()
    (tmp_path / "files").mkdir()
    board = serve("--machine", "micropython", "--files", str(tmp_path / "files"))
    for command in ("deploy", "undeploy"):
        done = run_there(traps, SCRIPT, command, str(board.link))
        assert done.stdout.startswith("OK: "), done.stderr
    assert not (traps / "sprung").exists()


@pytest.mark.parametrize("machine", ["cpython", "circuitpython", "micropython"])
def test_a_virtual_board_starts_without_them(machine, traps):
    if machine == "micropython":
        vm_is_there()
    done = run_there(traps, SCRIPT, "status", "--port", f"virtual://?machine={machine}")
    assert done.stdout.startswith("mirrormount,"), done.stderr
    assert not (traps / "sprung").exists()


@pytest.mark.parametrize("module", ["mpremote", "pip"])
def test_a_module_is_run_as_it_is_installed(module, traps):
    assert run_there(traps, *python_module(module, "--help")).returncode == 0
    assert not (traps / "sprung").exists()


def test_every_child_python_is_started_so():
    """A list that begins with an interpreter goes on with -P (its path is safe) or -I (and isolated)."""
    names = ("sys.executable", "python")
    files = [path for part in ("host", "tools") for path in (ROOT / part).rglob("*.py")]
    started = []
    for path in files:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.List) and node.elts and ast.unparse(node.elts[0]) in names:
                started.append((path.relative_to(ROOT).as_posix(), ast.unparse(node)))
    assert {path for path, _ in started} >= {
        "host/mirrormount/terminal.py",
        "host/mirrormount_sim/machines.py",
    }
    at_the_root = "tools/test.py"  # which runs the tests of this repository, in its own folder
    unsafe = [(path, text) for path, text in started if "'-P'" not in text and "'-I'" not in text]
    assert [path for path, _ in unsafe if path != at_the_root] == []
