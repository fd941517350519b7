"""Facts about tools/_programs.py: how the scripts of tools/ start other programs, and how they end."""

import os
import re
import signal
import subprocess
import sys

import pytest
from scripts import ROOT, programs
from served import PATIENCE_S, wait_for


@pytest.mark.parametrize("name", ["HTTPS_PROXY", "http_proxy", "PIP_INDEX_URL", "PIP_CERT", "SSL_CERT_FILE"])
def test_settings_of_pip_and_proxy_are_passed_on(monkeypatch, name):
    monkeypatch.setenv(name, "a value of the user's")
    assert programs.child_env()[name] == "a value of the user's"


def test_pip_is_kept_off_the_systems_python():
    assert programs.child_env()["PIP_REQUIRE_VIRTUALENV"] == "1"


# Beside and behind others


@pytest.mark.skipif(sys.platform != "linux", reason="asks for Linux's kinds of scheduling")
@pytest.mark.parametrize(("program", "idle", "nice"), [("chrt", True, os.nice(0)), ("nice", False, 19)])
def test_what_comes_last_takes_the_processor_that_nobody_else_wants(monkeypatch, program, idle, nice):
    which = programs.shutil.which
    monkeypatch.setattr(programs.shutil, "which", lambda name: which(name) if name == program else None)
    ask = [sys.executable, "-c", "import os; print(os.sched_getscheduler(0) == os.SCHED_IDLE, os.nice(0))"]
    assert programs.run(ask) == (0, f"False {os.nice(0)}\n")
    assert programs.run(ask, last=True) == (0, f"{idle} {nice}\n")


AUTOGROUP = """
import pathlib, time
group, until = pathlib.Path("/proc/self/autogroup"), time.monotonic() + 60
while group.exists() and "nice 19" not in group.read_text() and time.monotonic() < until:
    time.sleep(0.01)
print(not group.exists() or "nice 19" in group.read_text())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux shares the processors among sessions")
def test_what_comes_last_comes_behind_other_sessions_too():
    assert programs.run([sys.executable, "-c", AUTOGROUP], last=True) == (0, "True\n")


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
import _programs
with _programs.Beside() as beside:
    beside.submit(_programs.run, {child!r}, last=True)
    time.sleep(600)
"""
    run = subprocess.Popen([sys.executable, "-c", program], stderr=subprocess.DEVNULL, start_new_session=True)
    wait_for(lambda: (tmp_path / "began").exists(), "the child")
    run.send_signal(signal.SIGINT)
    assert run.wait(PATIENCE_S) != 0
    assert (tmp_path / "ended").exists()


def test_a_silent_command_is_followed_by_lines_of_progress(monkeypatch, tmp_path):
    lines, told = [], tmp_path / "told"
    os.mkfifo(told)

    def say(line: str) -> None:
        lines.append(line)
        if len(lines) == 1:
            told.write_text("")  # the command reads to its end: it is silent until a line of progress was told

    monkeypatch.setattr(programs, "PROGRESS_S", 0.01)
    monkeypatch.setattr(programs, "say", say)
    status, output = programs.run(
        [sys.executable, "-c", "import sys; open(sys.argv[1]).read(); print('done')", str(told)]
    )
    assert (status, output) == (0, "done\n")
    assert re.search(r"^ +-c .*argv.* … \d+ s$", lines[0])


SCRIPT = """
import sys
sys.path.insert(0, sys.argv[1])
import _programs as programs
child = [sys.executable, "-c", "import time; print('runs', flush=True); time.sleep(60)"]
sys.exit(programs.guarded(lambda _arguments: programs.show_quietly_ended(child)))
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


# How the scripts end


@pytest.mark.parametrize(("error", "status"), [(KeyboardInterrupt(), 130), (OSError("full"), 1)])
def test_what_goes_wrong_ends_in_one_line_and_a_status(monkeypatch, capsys, error, status):
    def main(arguments):
        raise error

    monkeypatch.setattr(programs.sys, "argv", ["demo.py"])
    assert programs.guarded(main) == status
    assert len(capsys.readouterr().out.strip().splitlines()) == 1


def test_status_of_a_shown_command_is_its_own():
    assert programs.show([sys.executable, "-c", "raise SystemExit(7)"]) == 7
