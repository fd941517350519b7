"""What holds for every test: its environment, its signals, and that with CI=true a test that is skipped fails.

Markers put tests into the levels of tools/test.py: pyproject.toml lists them.
"""

import os
import signal
import sys
import tempfile

import pytest

# what the user's environment may say to a test; all other settings of mirrormount are taken out of it
KEPT = ("MIRRORMOUNT_CACHE", "MIRRORMOUNT_FUZZ_", "MIRRORMOUNT_IMAGES")
ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
# not in the quick level: these folders and files, and what has a board in real time
SLOW = ("compat", "emulated", "panel", "test_micropython.py", "test_versions.py")
REAL_TIME = {"board", "boot", "browser", "deployed", "holder", "serve", "supervisor", "timed", "worker"}
ON_THE_HOST = ("beam", "epics", "host", "supervise", "repo")  # elsewhere, a fixture `board` is in lockstep


def pytest_itemcollected(item):
    folder = item.path.parent.name
    in_real_time = folder in ON_THE_HOST and REAL_TIME & {*getattr(item, "fixturenames", ())}
    if folder in SLOW or item.path.name in SLOW or in_real_time:
        item.add_marker("slow")


@pytest.fixture(autouse=True)
def _tracer_of_coverage():
    """The trace function of `coverage run` is set again after a test that sets its own."""
    tracer = sys.gettrace()
    yield
    if sys.gettrace() is not tracer:
        sys.settrace(tracer)


@pytest.fixture(scope="session", autouse=True)
def _default_signals():
    """A process that a test starts ends at a signal, also where the suite was started with it ignored.

    An ignored signal is inherited (nohup, a service, a job of a script); a caught one is not. So it is caught: SIGINT
    as Python does, for tests that interrupt a command, the others by what does nothing.
    """
    ignored = [number for number in ENDING if signal.getsignal(number) == signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, signal.default_int_handler if number == signal.SIGINT else lambda *_: None)
    yield
    for number in ignored:
        signal.signal(number, signal.SIG_IGN)


@pytest.fixture(scope="session", autouse=True)
def _own_environment(tmp_path_factory):
    """Settings and runtime files of this process of the suite, apart from the user's and from the other process's.

    `mirrormount stop` then stops only what the tests of this process have open. The names of sockets must be short.
    """
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory(prefix="mm-") as runtime:
        for name in [n for n in os.environ if n.startswith("MIRRORMOUNT_") and not n.startswith(KEPT)]:
            patch.delenv(name)
        patch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path_factory.mktemp("settings")))
        patch.setenv("XDG_RUNTIME_DIR", runtime)
        patch.setenv("TMPDIR", os.path.join(runtime, "tmp"))  # where programs that a test kills leave what they had
        os.mkdir(os.environ["TMPDIR"])
        yield


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    may_skip = hasattr(report, "wasxfail")
    if os.environ.get("CI") == "true" and report.skipped and not may_skip:
        report.outcome = "failed"
        report.longrepr = f"not run, and CI=true: {report.longrepr}"
    return report
