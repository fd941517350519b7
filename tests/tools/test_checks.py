"""Facts about tools/test.py, which runs all checks and tests, and about the suite that it runs."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from scripts import ROOT, bootstrap, checks, programs

GIT = checks.Need("a-command-nobody-has", "git", "a fresh clone", ("tests/clone",))


@pytest.fixture
def shown(monkeypatch):
    """The commands tools/test.py runs, all of which succeed, when one need is not met."""
    commands = []
    monkeypatch.setattr(bootstrap, "prepare", lambda *args, **options: None)
    monkeypatch.setattr(programs, "run", lambda command, **_: (commands.append(command[2:]) or 0, ""))
    monkeypatch.setattr(bootstrap, "apt_install", lambda packages, run: commands.append(["apt", *packages]))
    monkeypatch.setattr(programs, "show_quietly_ended", lambda command: commands.append(command[2:-2]) or 0)
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
    monkeypatch.setattr(programs, "run", lambda command, **_: (int("--quick" in command), "missed: stop-run"))
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
    monkeypatch.setattr(programs, "run", lambda command, **_: (int("basedpyright" in command), "an error of types"))
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
    monkeypatch.setattr(programs, "show_quietly_ended", pytest_that(statuses, reports))
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
