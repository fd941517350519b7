"""Facts about tools/demo.py and tools/test.py: how they find a Python, make .venv and fill it.

No test starts pip, uv, apt-get or the network: ``Machine`` stands in for every program.
"""

import ast
import os
import re
import sys
from pathlib import Path

import pytest
from scripts import ROOT, bootstrap, demo, programs

SCRIPTS = ["_bootstrap.py", "_programs.py", "demo.py", "test.py"]
WANTED = bootstrap.Wanted("tests", [["-r", "locked.txt"]], ["pyproject.toml"], ["numpy"])


class Machine:
    """Stands in for the programs the scripts start; remembers what they were asked."""

    def __init__(self, *, ensurepip=True, pip=(0, "ok"), healthy=True, imports=True, on_pip=None):
        self.ensurepip, self.pip, self.healthy, self.imports = ensurepip, pip, healthy, imports
        self.on_pip = on_pip
        self.asked = []

    def __call__(self, command):
        words = " ".join(command)
        self.asked.append(words)
        if "import ensurepip" in words:
            return (0 if self.ensurepip else 1), ""
        if " venv " in words:
            make_venv(Path(command[-1]))
        if bootstrap.HEALTH_CHECK in words:
            there = Path(command[0]).exists() and self.healthy
            return (0, "3.11.2\n") if there else (1, "No module named pip")
        if "-m pip install" in words:
            if self.on_pip:
                self.on_pip()
            self.imports = True
            return self.pip
        if "find_spec" in words:
            return (0 if self.imports else 1), ""
        return 0, ""

    def times(self, part):
        """How many commands contained these words."""
        return sum(part in words for words in self.asked)


def make_venv(venv, *, made_for=None):
    """The files of a virtual environment that matter here."""
    python = programs.venv_python(venv)
    python.parent.mkdir(parents=True, exist_ok=True)
    python.touch()
    (venv / "a-package").touch()
    if made_for:
        (venv / bootstrap.MADE).write_text(str(made_for))
    return venv


@pytest.fixture
def root(tmp_path):
    """A folder that looks like a clone."""
    (tmp_path / "pyproject.toml").write_text("one")
    return tmp_path


def prepare(root, machine, **options):
    bootstrap.prepare(root, WANTED, 3, run=machine, **options)


# An old Python


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_parses_on_python_3_8(name):
    ast.parse((ROOT / "tools" / name).read_text(encoding="utf-8"), feature_version=(3, 8))


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_uses_the_standard_library_only(name):
    tree = ast.parse((ROOT / "tools" / name).read_text(encoding="utf-8"))
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {name.split(".")[0] for name in names} <= set(sys.stdlib_module_names) | {"_bootstrap", "_programs"}


def test_newer_python_on_path_is_chosen_and_a_stand_in_is_passed_over():
    commands = bootstrap.candidates(lambda name: f"/bin/{name}" if name.startswith("python3.1") else None)
    versions = {"/bin/python3.14": (), "/bin/python3.13": (3, 13), "/bin/python3.12": (3, 12)}
    assert bootstrap.find_python(commands, lambda command: versions[command[0]]) == ["/bin/python3.13"]


def test_windows_launcher_is_asked_for_each_version():
    commands = bootstrap.candidates(lambda name: "C:/py.exe" if name == "py" else None)
    found = bootstrap.find_python(commands, lambda command: (3, 12) if command[1] == "-3.12" else ())
    assert found == ["C:/py.exe", "-3.12"]


def test_python_that_does_not_start_has_no_version():
    assert bootstrap.version_of(["python3.12"], lambda command: (127, "pyenv: python3.12: not found")) == ()


def test_python_3_10_is_not_new_enough():
    assert bootstrap.find_python([["python3"]], lambda command: (3, 10)) is None


def test_old_python_starts_over_with_the_newer_one(monkeypatch):
    started = []
    monkeypatch.setattr(bootstrap.sys, "version_info", (3, 8, 18))
    monkeypatch.setattr(bootstrap, "find_python", lambda commands, version: ["/bin/python3.12"])
    monkeypatch.setattr(bootstrap.os, "name", "posix")
    monkeypatch.setattr(bootstrap.os, "execv", lambda path, command: started.append((path, command)))
    bootstrap.ensure_python("/clone/tools/demo.py", ["--fast"])
    assert started == [("/bin/python3.12", ["/bin/python3.12", os.path.abspath("/clone/tools/demo.py"), "--fast"])]


@pytest.mark.parametrize("system", ["Debian", "Ubuntu", "Fedora", "macOS", "Windows"])
def test_without_a_newer_python_the_message_says_what_to_install(monkeypatch, system):
    monkeypatch.setattr(bootstrap.sys, "version_info", (3, 8, 18))
    monkeypatch.setattr(bootstrap, "find_python", lambda commands, version: None)
    with pytest.raises(programs.Stop, match=rf"(?s)this one is 3\.8.*{system}"):
        bootstrap.ensure_python("demo.py", [])


# .venv


def test_venv_is_made_and_marked(root):
    prepare(root, Machine())
    assert (root / ".venv" / bootstrap.MADE).read_text() == str(root / ".venv")


def test_half_made_venv_is_removed_and_made_again(root, capsys):
    (root / ".venv" / "lib").mkdir(parents=True)
    prepare(root, Machine())
    assert not (root / ".venv" / "lib").exists()
    assert "half made: making it again" in capsys.readouterr().out


def test_venv_made_for_another_folder_is_made_again(root):
    make_venv(root / ".venv", made_for="/elsewhere/.venv")
    machine = Machine()
    prepare(root, machine)
    assert machine.times("-m venv") == 1


def test_working_venv_of_the_user_is_used_as_it_is(root, capsys):
    make_venv(root / ".venv")
    machine = Machine()
    prepare(root, machine)
    assert machine.times("-m venv") == 0
    assert "not made by this script, but works" in capsys.readouterr().out


def test_venv_with_an_old_python_is_not_removed(root):
    make_venv(root / ".venv")
    with pytest.raises(programs.Stop, match=r"holds Python 3\.9\.1"):
        bootstrap.ensure_venv(root / ".venv", lambda command: (0, "3.9.1"))
    assert (root / ".venv" / "a-package").exists()


def test_link_to_a_broken_venv_is_removed_without_what_it_points_to(root):
    (root / "elsewhere").mkdir()
    (root / "elsewhere" / "precious").touch()
    try:
        (root / ".venv").symlink_to(root / "elsewhere", target_is_directory=True)
    except OSError:
        pytest.skip("this user may not make links")
    prepare(root, Machine())
    assert (root / "elsewhere" / "precious").exists()


def test_new_venv_that_does_not_work_is_not_marked(root):
    with pytest.raises(programs.Stop, match="half made"):
        prepare(root, Machine(healthy=False))
    assert not (root / ".venv" / bootstrap.MADE).exists()


# A Python without ensurepip


def tools(*names):
    """A machine's PATH with only these commands on it."""
    return lambda name: f"/bin/{name}" if name in names else None


def test_without_ensurepip_uv_makes_the_venv(root):
    machine = Machine(ensurepip=False)
    bootstrap.create_venv(root / ".venv", machine, may_install=True, which=tools("uv", "apt-get"))
    assert machine.times("/bin/uv venv --seed") == 1
    assert machine.times("apt-get") == 0


def test_without_ensurepip_and_uv_the_apt_line_is_given(root):
    machine = Machine(ensurepip=False)
    line = "sudo apt install python{}.{}-venv".format(*sys.version_info)
    with pytest.raises(programs.Stop, match=re.escape(line)):
        bootstrap.create_venv(root / ".venv", machine, may_install=False, which=tools("apt-get"))
    assert machine.times("apt-get") == 0


def test_without_ensurepip_the_package_is_installed_if_that_is_allowed(root):
    machine = Machine(ensurepip=False)
    bootstrap.create_venv(root / ".venv", machine, may_install=True, which=tools("apt-get"))
    steps = [words.split("apt-get ")[1] for words in machine.asked if "apt-get" in words]
    package = "python{}.{}-venv".format(*sys.version_info)
    assert steps == ["update", "install -y --no-install-recommends " + package]


# pip


def test_second_run_does_not_ask_pip(root):
    prepare(root, Machine())
    second = Machine()
    prepare(root, second)
    assert second.times("-m pip") == 0


def test_changed_pyproject_asks_pip_again(root):
    prepare(root, Machine())
    (root / "pyproject.toml").write_text("two")
    second = Machine()
    prepare(root, second)
    assert second.times("-m pip install -r locked.txt") == 1


def test_interrupted_pip_makes_the_next_run_start_with_a_new_venv(root):
    def interrupt():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        prepare(root, Machine(on_pip=interrupt))
    (root / ".venv" / "half-a-package").touch()
    second = Machine()
    prepare(root, second)
    assert not (root / ".venv" / "half-a-package").exists()
    assert second.times("-m pip install") == 1


def test_damaged_package_has_the_venv_made_again(root):
    prepare(root, Machine())
    second = Machine(imports=False)
    prepare(root, second)
    assert second.times("-m venv") == 1
    assert second.times("-m pip install") == 1


def test_one_script_does_not_undo_what_the_other_has_prepared(root):
    prepare(root, Machine())
    bootstrap.prepare(root, WANTED._replace(purpose="demo"), 3, run=Machine())
    third = Machine()
    prepare(root, third)
    assert third.times("-m pip") == 0


@pytest.mark.parametrize(
    ("output", "remedy"),
    [
        ("OSError: [Errno 28] No space left on device", "disk is full"),
        ("NewConnectionError: Temporary failure in name resolution", "network, HTTPS_PROXY"),
        ("SSLError: CERTIFICATE_VERIFY_FAILED", "PIP_CERT"),
        ("something new", "Run the same command again"),
    ],
)
def test_failure_of_pip_ends_in_its_last_lines_and_a_remedy(root, output, remedy):
    with pytest.raises(programs.Stop) as stop:
        prepare(root, Machine(pip=(1, f"first line\n{output}\n")))
    assert output in str(stop.value)
    assert remedy in str(stop.value).splitlines()[-1]


# The demo


def test_demo_passes_arguments_on_and_needs_no_screen(monkeypatch):
    shown = []
    monkeypatch.setattr(bootstrap, "prepare", lambda *args, **options: None)
    monkeypatch.setattr(programs, "show", lambda command, **env: shown.append((command[1:], env)) or 5)
    assert demo.main(["--seed", "1"]) == 5
    assert shown == [(["-P", "-m", "mirrormount", "demo", "--seed", "1"], {"MPLBACKEND": "Agg"})]
