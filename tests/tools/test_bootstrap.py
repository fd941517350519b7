"""Facts about tools/demo.py and tools/test.py: how they find a Python, make .venv and fill it.

No test starts pip, uv, apt-get or the network: ``Machine`` stands in for every program.
"""

import ast
import importlib.util
import os
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from served import PATIENCE_S, wait_for

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = ["_bootstrap.py", "demo.py", "test.py"]


def load(name, register_as):
    """A script of tools/ as a module, registered so that the scripts can import each other."""
    spec = importlib.util.spec_from_file_location(register_as, ROOT / "tools" / name)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[register_as] = module
    spec.loader.exec_module(module)
    return module


bootstrap = load("_bootstrap.py", "_bootstrap")
demo = load("demo.py", "mirrormount_tools_demo")
checks = load("test.py", "mirrormount_tools_test")

WANTED = bootstrap.Wanted("tests", [["-r", "locked.txt"]], ["pyproject.toml"], ["numpy"])
GIT = checks.Need("a-command-nobody-has", "git", "a fresh clone", ("tests/clone",))


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
    python = bootstrap.venv_python(venv)
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
    assert {name.split(".")[0] for name in names} <= set(sys.stdlib_module_names) | {"_bootstrap"}


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
    with pytest.raises(bootstrap.Stop, match=rf"(?s)this one is 3\.8.*{system}"):
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
    with pytest.raises(bootstrap.Stop, match=r"holds Python 3\.9\.1"):
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
    with pytest.raises(bootstrap.Stop, match="half made"):
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
    with pytest.raises(bootstrap.Stop, match=re.escape(line)):
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
    with pytest.raises(bootstrap.Stop) as stop:
        prepare(root, Machine(pip=(1, f"first line\n{output}\n")))
    assert output in str(stop.value)
    assert remedy in str(stop.value).splitlines()[-1]


@pytest.mark.parametrize("name", ["HTTPS_PROXY", "http_proxy", "PIP_INDEX_URL", "PIP_CERT", "SSL_CERT_FILE"])
def test_settings_of_pip_and_proxy_are_passed_on(monkeypatch, name):
    monkeypatch.setenv(name, "a value of the user's")
    assert bootstrap.child_env()[name] == "a value of the user's"


def test_pip_is_kept_off_the_systems_python():
    assert bootstrap.child_env()["PIP_REQUIRE_VIRTUALENV"] == "1"


# How the scripts end


@pytest.mark.parametrize(("error", "status"), [(KeyboardInterrupt(), 130), (OSError("full"), 1)])
def test_what_goes_wrong_ends_in_one_line_and_a_status(monkeypatch, capsys, error, status):
    def main(arguments):
        raise error

    monkeypatch.setattr(bootstrap.sys, "argv", ["demo.py"])
    assert bootstrap.guarded(main) == status
    assert len(capsys.readouterr().out.strip().splitlines()) == 1


def test_status_of_a_shown_command_is_its_own():
    assert bootstrap.show([sys.executable, "-c", "raise SystemExit(7)"]) == 7


def test_demo_passes_arguments_on_and_needs_no_screen(monkeypatch):
    shown = []
    monkeypatch.setattr(bootstrap, "prepare", lambda *args, **options: None)
    monkeypatch.setattr(bootstrap, "show", lambda command, **env: shown.append((command[1:], env)) or 5)
    assert demo.main(["--seed", "1"]) == 5
    assert shown == [(["-P", "-m", "mirrormount", "demo", "--seed", "1"], {"MPLBACKEND": "Agg"})]


# tools/test.py


@pytest.fixture
def shown(monkeypatch):
    """The commands tools/test.py runs, all of which succeed, when one need is not met."""
    commands = []
    monkeypatch.setattr(bootstrap, "prepare", lambda *args, **options: None)
    monkeypatch.setattr(bootstrap, "run", lambda command, **_: (commands.append(command[2:]) or 0, ""))
    monkeypatch.setattr(bootstrap, "apt_install", lambda packages, run: commands.append(["apt", *packages]))
    monkeypatch.setattr(bootstrap, "show_quietly_ended", lambda command: commands.append(command[2:-2]) or 0)
    monkeypatch.setattr(checks, "NEEDS", (GIT,))
    monkeypatch.delenv("CI", raising=False)
    return commands


def test_on_ci_an_unmet_need_is_installed_and_a_failure_if_still_unmet(shown, monkeypatch, capsys):
    monkeypatch.setenv("CI", "true")
    assert checks.main([]) == 1
    assert ["apt", "git"] in shown
    assert re.search(r"FAILED +tests/clone", capsys.readouterr().out)


def test_elsewhere_an_unmet_need_is_listed_as_not_run(shown, capsys):
    assert checks.main([]) == 0
    assert ["apt", "git"] not in shown
    output = capsys.readouterr().out
    assert re.search(r"not run +tests/clone", output)
    assert "sudo apt install git" in output


def test_install_system_allows_apt_outside_ci(shown):
    assert checks.main(["--install-system"]) == 0
    assert ["apt", "git"] in shown


def test_pytest_comes_last_with_its_arguments_and_without_what_cannot_run(shown):
    checks.main(["--", "-k", "frame"])
    words = ["--deselect=tests/clone", "-k", "frame"]
    assert shown[-2:] == [
        ["pytest", "--wall-clock=without", *checks.PARALLEL, *words],
        ["pytest", "--wall-clock=only", *words],
    ]


def test_a_whole_run_has_the_coverage_of_its_first_pytest(shown):
    checks.main([])
    first = next(words for words in shown if words[0] == "pytest")
    words = ["--lockstep=without", "--coverage", "--deselect=tests/clone"]
    assert first == ["pytest", "--wall-clock=without", *checks.PARALLEL, *words]
    assert ["coverage", "report", "--fail-under=0"] in shown


def test_only_a_whole_run_checks_the_times_of_the_firmware(shown, monkeypatch, capsys):
    times = ["--check", "--quick", "--jobs", "1"]
    checks.main([])
    assert times in shown
    shown.clear()
    checks.main(["--", "-k", "frame"])
    assert times not in shown
    monkeypatch.setattr(bootstrap, "run", lambda command, **_: (int("--quick" in command), "missed: stop-run"))
    assert checks.main([]) == 1
    output = capsys.readouterr().out
    assert "missed: stop-run" in output and re.search(r"FAILED +times", output)


def test_only_a_whole_run_has_a_run_of_its_own_for_the_tests_in_lockstep(shown):
    def apart():
        return [words for words in shown if "--lockstep=only" in words]

    checks.main([])
    assert len(apart()) == 1 and "--deselect=tests/clone" in apart()[0]
    shown.clear()
    checks.main(["--", "-k", "frame"])
    assert not apart()


def test_the_floor_of_the_coverage_counts_on_ci(shown, monkeypatch):
    monkeypatch.setenv("CI", "true")
    checks.main([])
    assert ["coverage", "report"] in shown


def test_one_failed_check_fails_the_whole_but_stops_nothing(shown, monkeypatch, capsys):
    monkeypatch.setattr(bootstrap, "run", lambda command, **_: (int("basedpyright" in command), "an error of types"))
    assert checks.main([]) == 1
    output = capsys.readouterr().out
    assert "an error of types" in output
    assert re.search(r"FAILED +types", output)
    assert re.search(r"ok +tests", output)


def pytest_that(statuses, reports):
    """Stands in for pytest: ends with these statuses, one a run, and writes these reports."""
    statuses, reports = iter(statuses), iter(reports)

    def run(command):
        Path(command[-1]).write_text(next(reports))
        return next(statuses)

    return run


def report(tests, failures=0, errors=0, skipped=0):
    """What pytest writes with --junit-xml, without its cases."""
    numbers = f'errors="{errors}" failures="{failures}" skipped="{skipped}" tests="{tests}"'
    return f'<?xml version="1.0" encoding="utf-8"?><testsuites><testsuite name="pytest" {numbers}/></testsuites>'


@pytest.mark.parametrize(
    ("statuses", "reports", "status", "last"),
    [
        ((0, 0), (report(10, skipped=1), report(3)), 0, "12 passed, 0 failed, 1 skipped"),
        ((0, 1), (report(10), report(3, failures=1, errors=1)), 1, "11 passed, 2 failed, 0 skipped"),
        ((1, 0), (report(10, failures=4), report(3)), 1, "9 passed, 4 failed, 0 skipped"),
        ((0, 5), (report(10), report(0)), 0, "10 passed, 0 failed, 0 skipped"),
        ((5, 5), (report(0), report(0)), 1, "0 passed, 0 failed, 0 skipped"),
    ],
)
def test_the_last_line_and_the_status_are_of_both_runs_of_pytest(
    shown, monkeypatch, capsys, statuses, reports, status, last
):
    monkeypatch.setattr(checks, "NEEDS", ())
    monkeypatch.setattr(bootstrap, "show_quietly_ended", pytest_that(statuses, reports))
    assert checks.main([]) == status
    assert capsys.readouterr().out.splitlines()[-1] == last


@pytest.mark.skipif(sys.platform != "linux", reason="asks for Linux's kinds of scheduling")
@pytest.mark.parametrize(("program", "idle", "nice"), [("chrt", True, os.nice(0)), ("nice", False, 19)])
def test_what_comes_last_takes_the_processor_that_nobody_else_wants(monkeypatch, program, idle, nice):
    which = bootstrap.shutil.which
    monkeypatch.setattr(bootstrap.shutil, "which", lambda name: which(name) if name == program else None)
    ask = [sys.executable, "-c", "import os; print(os.sched_getscheduler(0) == os.SCHED_IDLE, os.nice(0))"]
    assert bootstrap.run(ask) == (0, f"False {os.nice(0)}\n")
    assert bootstrap.run(ask, last=True) == (0, f"{idle} {nice}\n")


AUTOGROUP = """
import pathlib, time
group, until = pathlib.Path("/proc/self/autogroup"), time.monotonic() + 60
while group.exists() and "nice 19" not in group.read_text() and time.monotonic() < until:
    time.sleep(0.01)
print(not group.exists() or "nice 19" in group.read_text())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux shares the processors among sessions")
def test_what_comes_last_comes_behind_other_sessions_too():
    assert bootstrap.run([sys.executable, "-c", AUTOGROUP], last=True) == (0, "True\n")


WAITS = """
import pathlib, time
pathlib.Path("began").touch()
try:
    time.sleep(600)
finally:
    pathlib.Path("ended").touch()
"""


def test_ctrl_c_ends_what_comes_last_too(tmp_path):
    child = [sys.executable, "-c", f"import os; os.chdir({str(tmp_path)!r})\n{WAITS}"]
    tools = str(ROOT / "tools")
    program = f"""import sys, time
sys.path.insert(0, {tools!r})
import _bootstrap
with _bootstrap.Beside() as beside:
    beside.submit(_bootstrap.run, {child!r}, last=True)
    time.sleep(600)
"""
    run = subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.DEVNULL, start_new_session=True)
    wait_for(lambda: (tmp_path / "began").exists(), "the child")
    run.send_signal(signal.SIGINT)
    assert run.wait(PATIENCE_S) != 0
    assert (tmp_path / "ended").exists()


def test_a_silent_command_is_followed_by_lines_of_progress(monkeypatch, capsys):
    monkeypatch.setattr(bootstrap, "PROGRESS_S", 0.01)
    status, output = bootstrap.run([sys.executable, "-c", "import time; time.sleep(0.5); print('done')"])
    assert (status, output) == (0, "done\n")
    assert re.search(r"^ +-c .*sleep.* … \d+ s$", capsys.readouterr().out, re.MULTILINE)


SCRIPT = """
import sys
sys.path.insert(0, sys.argv[1])
import _bootstrap as bootstrap
child = [sys.executable, "-c", "import time; print('runs', flush=True); time.sleep(60)"]
sys.exit(bootstrap.guarded(lambda _arguments: bootstrap.show_quietly_ended(child)))
"""


@pytest.mark.skipif(os.name == "nt", reason="a console of Windows has no process groups that a test could signal")
def test_ctrl_c_in_a_check_ends_in_one_line_though_the_check_prints_a_traceback():
    command = [sys.executable, "-c", SCRIPT, str(ROOT / "tools")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as script:
        assert script.stdout.readline() == "runs\n"
        os.killpg(script.pid, signal.SIGINT)  # as a terminal does: to every process in front of it
        out, err = script.communicate(timeout=60)
    assert (script.returncode, err) == (130, "")
    assert out.strip() == "Stopped; the same command carries on from here."


# The suite itself

SUITE = ROOT / "tests" / "conftest.py"


@pytest.mark.skipif(os.name == "nt", reason="Windows has no nohup")
def test_a_process_that_a_test_starts_has_default_signals_though_the_suite_was_started_with_them_ignored(tmp_path):
    (tmp_path / "conftest.py").write_text(SUITE.read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "test_it.py").write_text(
        "import signal, subprocess, sys\n"
        "def test_it():\n"
        "    code = 'import signal as s; print([s.getsignal(n) != s.SIG_IGN for n in (s.SIGINT, s.SIGHUP)])'\n"
        "    assert subprocess.check_output([sys.executable, '-c', code]) == b'[True, True]\\n'\n"
        "    signal.raise_signal(signal.SIGHUP)  # the suite itself goes on\n"
    )
    line = 'trap "" INT HUP; exec "$@"'
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", tmp_path, tmp_path]
    run = subprocess.run(["bash", "-c", line, "bash", sys.executable, *words], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout


def test_a_test_sees_no_setting_of_the_users_and_a_runtime_folder_of_its_own():
    kept = ("MIRRORMOUNT_CACHE", "MIRRORMOUNT_FUZZ_", "MIRRORMOUNT_IMAGES")
    mine = [name for name in os.environ if name.startswith("MIRRORMOUNT_") and not name.startswith(kept)]
    assert mine == ["MIRRORMOUNT_CONFIG"]
    for name in ("MIRRORMOUNT_CONFIG", "XDG_RUNTIME_DIR"):
        assert Path(os.environ[name]).stat().st_mode & 0o777 == 0o700


# The lock


LOCKS = ["tests/requirements.txt", "tools/demo-requirements.txt"]


def locked(lock):
    """The names in a lock file and their versions (several, where Pythons differ)."""
    text = (ROOT / lock).read_text(encoding="utf-8")
    return re.findall(r"^([a-z0-9-]+)==(\S+)", text, re.MULTILINE)


def wanted_by_the_project():
    """What mirrormount needs, its plots, and what builds it."""
    text = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project, build = text["project"], text["build-system"]
    return [*project["dependencies"], *project["optional-dependencies"]["plot"], *build["requires"]]


@pytest.mark.parametrize("lock", LOCKS)
def test_every_dependency_of_the_project_is_locked_within_its_range(lock):
    for line in wanted_by_the_project():
        wanted = Requirement(line)
        versions = [version for name, version in locked(lock) if name == wanted.name]
        assert versions, line
        assert all(version in wanted.specifier for version in versions), line


def test_both_scripts_put_the_same_versions_into_the_one_environment():
    assert set(locked(LOCKS[1])) <= set(locked(LOCKS[0]))


@pytest.mark.parametrize("script", [demo, checks])
def test_nothing_is_installed_whose_hash_is_not_locked(script):
    *files, ourselves = script.WANTED.pip_arguments
    assert [words[:-1] for words in files] == [("--no-deps", "--require-hashes", "-r")]
    assert files[0][-1] in LOCKS and files[0][-1] in script.WANTED.files
    assert ourselves == ("--no-deps", "--no-build-isolation", "-e", ".")
    text = (ROOT / files[0][-1]).read_text(encoding="utf-8")
    requirements = re.split(r"^(?=[a-z])", text, flags=re.MULTILINE)[1:]
    assert all("--hash=sha256:" in requirement for requirement in requirements)
    assert "editables" in dict(locked(files[0][-1]))  # hatchling asks for it when it builds for -e


@pytest.mark.parametrize("lock", LOCKS)
def test_lock_names_no_host_and_no_folder(lock):
    lines = (ROOT / lock).read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if re.search(r"://|index-url|find-links|^-|(^| )/", line)] == []


@pytest.mark.skipif(os.name == "nt", reason="bash is not on every Windows")
def test_ci_entry_is_valid_bash_and_executable():
    subprocess.run(["bash", "-n", str(ROOT / ".ci" / "run")], check=True)
    assert os.access(ROOT / ".ci" / "run", os.X_OK)
