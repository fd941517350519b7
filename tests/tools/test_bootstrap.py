"""Facts about tools/demo.py and tools/test.py: how they find a Python, make .venv and fill it.

No test starts pip, apt-get or the network: ``machine`` stands in for every program.
"""

import ast
import os
import signal
import subprocess
import sys

import pytest
from scripts import ROOT, bootstrap, demo, mechanics

SCRIPTS = ["_bootstrap.py", "demo.py", "test.py", "mechanics/make.py"]


class Machine:
    """Stands in for the programs that the scripts start: remembers their words; fails: words of those that fail."""

    def __init__(self, root):
        self.root = root
        self.asked = []
        self.fails = ()

    def __call__(self, command, **options):
        words = " ".join(map(str, command))
        self.asked.append(words)
        there = (self.root / ".venv" / "pyvenv.cfg").exists()
        if any(part in words for part in self.fails) or (bootstrap.HAS_PIP in words and not there):
            return 1
        if " -m venv " in words:
            (self.root / ".venv").mkdir(exist_ok=True)
            (self.root / ".venv" / "pyvenv.cfg").touch()
        return 0

    def times(self, part):
        return sum(part in words for words in self.asked)


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A computer with a fresh clone: tmp_path."""
    for name in ("locked.txt", "pyproject.toml", "firmware_py/mountfw/__init__.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("one")
    machine = Machine(tmp_path)
    monkeypatch.setattr(bootstrap, "ROOT", tmp_path)
    monkeypatch.setattr(bootstrap, "VENV", tmp_path / ".venv")
    monkeypatch.setattr(bootstrap, "call", machine)
    return machine


@pytest.mark.parametrize("name", SCRIPTS)
def test_python_3_8_can_read_a_script_and_has_all_that_it_imports(name):
    tree = ast.parse((ROOT / "tools" / name).read_text(encoding="utf-8"), feature_version=(3, 8))
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {name.split(".")[0] for name in names} <= set(sys.stdlib_module_names) | {"_bootstrap"}


def test_an_old_python_starts_over_with_a_newer_one(machine, monkeypatch):
    monkeypatch.setattr(bootstrap.sys, "version_info", (3, 8, 18))
    monkeypatch.setattr(bootstrap.sys, "argv", ["tools/demo.py", "--fast"])
    machine.fails = ["python3.14", "python3.13 -c"]  # there is none; a stand-in that starts none
    with pytest.raises(SystemExit, match=r"^0$"):
        bootstrap.ensure_python()
    assert machine.asked[-1] == "python3.12 tools/demo.py --fast"


def test_without_a_newer_python_one_is_told_what_to_install(machine, monkeypatch, capsys):
    monkeypatch.setattr(bootstrap.sys, "version_info", (3, 8, 18))
    machine.fails = ["py"]
    assert bootstrap.guarded(demo.main) == 1
    told = capsys.readouterr().out
    assert "this one is 3.8" in told and all(
        name in told for name in ("Debian", "Ubuntu", "Fedora", "macOS", "Windows")
    )


def test_a_clone_gets_a_venv_with_the_locked_packages_once_until_the_lock_changes(machine, tmp_path):
    bootstrap.prepare("tests", "locked.txt")
    assert machine.times("-m venv --clear") == 1
    assert machine.times("--no-deps --require-hashes -r locked.txt") == 1 and machine.times("-m pip") == 2
    bootstrap.prepare("tests", "locked.txt")
    assert machine.times("-m venv") == 1 and machine.times("-m pip") == 2
    (tmp_path / "locked.txt").write_text("two")
    bootstrap.prepare("tests", "locked.txt")
    assert machine.times("-m venv") == 1 and machine.times("-m pip") == 4


@pytest.mark.parametrize(
    ("fails", "told"),
    [
        (["pip install"], "pip install failed.*network.*delete the folder .venv"),
        (["-m venv"], "Making .venv failed.*disk full"),
        ([bootstrap.IS_OLD], "a Python that is older than 3.11"),
    ],
)
def test_a_failure_is_one_clear_line_and_the_next_run_tries_again(machine, fails, told):
    if fails == [bootstrap.IS_OLD]:
        machine([" -m venv "])  # one that the user made
    machine.fails = fails
    with pytest.raises(bootstrap.Stop, match=told):
        bootstrap.prepare("tests", "locked.txt")
    machine.fails = []
    bootstrap.prepare("tests", "locked.txt")
    assert "-m pip install" in machine.asked[-1]


def test_a_folder_of_the_users_that_is_called_venv_is_not_emptied(machine, tmp_path):
    (tmp_path / ".venv").mkdir()
    with pytest.raises(bootstrap.Stop, match="no virtual environment"):
        bootstrap.prepare("tests", "locked.txt")
    assert machine.times("-m venv") == 0


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="there is no apt-get on Windows")
@pytest.mark.parametrize("may_install", [False, True])
def test_what_debian_has_left_out_of_python_is_installed_or_named(machine, monkeypatch, may_install):
    package = "python{}.{}-venv".format(*sys.version_info)
    monkeypatch.setattr(bootstrap.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(bootstrap.shutil, "which", lambda name: f"/bin/{name}")
    if may_install:
        bootstrap.prepare("tests", "locked.txt", may_install=True)
    else:
        with pytest.raises(bootstrap.Stop, match=f"sudo apt install {package}$"):
            bootstrap.prepare("tests", "locked.txt")
    assert machine.times(f"apt-get install -y --no-install-recommends {package}") == may_install


# How a script and the programs that it starts end


def test_the_demo_passes_arguments_on_and_needs_no_screen(monkeypatch):
    called = []
    monkeypatch.setattr(bootstrap, "prepare", lambda *words: None)
    monkeypatch.setattr(bootstrap, "call", lambda command, **options: called.append((command[1:], options)) or 5)
    assert demo.main(["--seed", "1"]) == 5
    assert called == [
        (["-P", "-m", "mirrormount", "demo", "--seed", "1"], {"cwd": None, "environment": {"MPLBACKEND": "Agg"}})
    ]


def test_the_parts_are_made_in_the_callers_folder_with_what_their_lock_names(monkeypatch):
    called = []
    monkeypatch.setattr(bootstrap, "prepare", lambda *words: called.append(words))
    monkeypatch.setattr(bootstrap, "call", lambda command, **options: called.append((command[1:], options)) or 5)
    assert mechanics.main(["km100"]) == 5
    program = str(ROOT / "tools" / "mechanics" / "files.py")
    assert called == [("mechanics", "tools/mechanics/requirements.txt"), ([program, "km100"], {"cwd": None})]


def test_a_program_has_the_users_settings_and_its_status_is_told(monkeypatch):
    monkeypatch.setenv("HTTPS_PROXY", "the user's")
    code = "import os, sys; sys.exit(7 * (os.environ['HTTPS_PROXY'] == os.environ['ONE'] == \"the user's\"))"
    assert bootstrap.call([sys.executable, "-c", code], environment={"ONE": "the user's"}) == 7
    assert bootstrap.call(["no-such-program"]) == 127


INTERRUPTED = """
import sys
sys.path.insert(0, sys.argv.pop(1))
import _bootstrap
child = [sys.executable, "-c", '''
try:
    print("runs", flush=True)
    for _ in range(1 << 30):  # a signal that comes just before a sleep would be seen after it
        pass
except KeyboardInterrupt:
    print("tidied up", flush=True)
''']
sys.exit(_bootstrap.guarded(lambda words: _bootstrap.call(child)))
"""


@pytest.mark.skipif(os.name == "nt", reason="a console of Windows has no process groups that a test could signal")
def test_ctrl_c_ends_in_one_line_after_what_was_started_has_ended():
    command = [sys.executable, "-c", INTERRUPTED, str(ROOT / "tools")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as script:
        assert script.stdout.readline() == "runs\n"
        os.killpg(script.pid, signal.SIGINT)  # as a terminal does: to every process in front of it
        out = script.communicate(timeout=60)[0]
    assert script.returncode == 130
    assert out.split("\n") == ["tidied up", "", "Stopped; the same command carries on from here.", ""]
