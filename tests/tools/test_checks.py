"""Facts about tools/test.py, which runs all checks and tests, and about the suite that it runs."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from scripts import ROOT, bootstrap, checks


@pytest.fixture
def called(monkeypatch):
    """The commands that tools/test.py runs, all of which succeed, on a machine without git-annex."""
    commands = []
    monkeypatch.setattr(bootstrap, "prepare", lambda *words: None)
    monkeypatch.setattr(bootstrap, "call", lambda command, **environment: commands.append(command[1:]) or 0)
    monkeypatch.setattr(bootstrap, "apt_install", lambda packages: commands.append(["apt", *packages]))
    monkeypatch.setattr(checks, "NEEDS", {"git-annex": ["a-command-nobody-has", "/no/such/folder"], "sh": ["python3"]})
    monkeypatch.delenv("CI", raising=False)
    return commands


@pytest.mark.parametrize(
    ("words", "ci", "installs", "status", "told"),
    [
        ([], "", False, 0, r"not run +what needs: sudo apt install git-annex"),
        (["--install-system"], "", True, 0, r"not run +what needs: sudo apt install git-annex"),
        ([], "true", True, 1, r"FAILED +what needs: sudo apt install git-annex"),
        (["--quick"], "true", False, 0, "ok"),  # needs nothing of it
    ],
)
def test_what_is_missing_is_installed_if_allowed_and_told_and_a_failure_on_ci(
    called, monkeypatch, capsys, words, ci, installs, status, told
):
    monkeypatch.setenv("CI", ci)
    assert checks.main(words) == status
    assert (["apt", "git-annex"] in called) == installs
    assert re.search(told, capsys.readouterr().out)


def runs(called):
    """What is selected in each run of pytest."""
    return [words[words.index("-m", words.index("pytest")) + 1] for words in called if "pytest" in words]


def selected(expression, marks):
    """Whether pytest's -m takes a test with these marks."""
    return eval(expression, {name: name in marks for name in ("slow", "full", "wall_clock")})


@pytest.mark.parametrize("level", ["quick", "default", "full"])
def test_each_test_of_a_level_is_in_one_run_of_it(called, level):
    checks.main([] if level == "default" else ["--" + level])
    for marks in ([], ["slow"], ["wall_clock"], ["full"], ["full", "slow"], ["full", "wall_clock"]):
        left_out = {"quick": marks != [], "default": "full" in marks, "full": False}[level]
        assert sum(selected(expression, marks) for expression in runs(called)) == (not left_out), marks


def test_only_a_full_run_has_the_coverage_and_the_times_of_the_firmware_and_not_of_some_tests(called):
    for words, whole in ([[], False], [["--full"], True], [["--full", "--", "-k", "frame"], False]):
        called.clear()
        checks.main(words)
        assert (["-m", "coverage", "report"] in called) == whole
        assert (["tools/bench/run.py", "--check", "--quick"] in called) == whole
    assert all(words[-4:-2] == ["-k", "frame"] for words in called if "pytest" in words)


@pytest.mark.parametrize("level", ["--quick", "--full"])
def test_only_a_full_run_installs_what_the_solids_of_the_parts_need(called, monkeypatch, level):
    locks = []
    monkeypatch.setattr(bootstrap, "prepare", lambda purpose, lock, *words: locks.append(lock))
    checks.main([level])
    assert locks == ["tests/requirements.txt", "tools/mechanics/requirements.txt"][: 1 + (level == "--full")]


def test_one_failed_check_fails_the_whole_but_stops_nothing(called, monkeypatch, capsys):
    monkeypatch.setattr(bootstrap, "call", lambda command, **environment: int("basedpyright" in command))
    assert checks.main([]) == 1
    assert re.search(r"FAILED +types[^\0]*ok +tests", capsys.readouterr().out)


def report(tests, failures=0, errors=0, skipped=0):
    """What pytest writes with --junit-xml, without its cases."""
    numbers = f'errors="{errors}" failures="{failures}" skipped="{skipped}" tests="{tests}"'
    return f'<?xml version="1.0" encoding="utf-8"?><testsuites><testsuite name="pytest" {numbers}/></testsuites>'


@pytest.mark.parametrize(
    ("statuses", "reports", "status", "last"),
    [
        ((0, 0), (report(10, skipped=1), report(3)), 0, "12 passed, 0 failed, 1 skipped"),
        ((0, 1), (report(10), report(3, failures=1, errors=1)), 1, "11 passed, 2 failed, 0 skipped"),
        ((0, 5), (report(10), report(0)), 0, "10 passed, 0 failed, 0 skipped"),
        ((5, 5), (report(0), report(0)), 1, "0 passed, 0 failed, 0 skipped"),
    ],
)
def test_the_last_line_and_the_status_are_of_both_runs_of_pytest(
    called, monkeypatch, capsys, statuses, reports, status, last
):
    ends = iter(zip(statuses, reports, strict=True))

    def call(command, **environment):
        if "pytest" not in command:
            return 0
        status, text = next(ends)
        Path(command[-1]).write_text(text)
        return status

    monkeypatch.setattr(bootstrap, "call", call)
    assert checks.main([]) == status
    assert capsys.readouterr().out.splitlines()[-1] == last


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
