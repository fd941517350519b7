"""With CI=true what is not run is a failure: a skipped test fails, and says what it needs.

Tests that are marked exhaustive take hours; they are left out without --exhaustive.
Tests that are marked wall_clock are judged by the time of this computer, and need it for themselves: tools/test.py runs
all others in two processes with --wall-clock=without, then these alone with --wall-clock=only.
"""

import os
import signal
import tempfile

import pytest

# what the user's environment may say to a test; all other settings of mirrormount are taken out of it
KEPT = ("MIRRORMOUNT_CACHE", "MIRRORMOUNT_FUZZ_", "MIRRORMOUNT_IMAGES")
ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def pytest_addoption(parser):
    parser.addoption("--exhaustive", action="store_true", help="also cut the power at every operation of the flash")
    parser.addoption(
        "--wall-clock",
        choices=["with", "without", "only"],
        default="with",
        help="tests that need the computer for themselves: with all others, left out, or they alone",
    )


def pytest_configure(config):
    config.addinivalue_line("markers", "exhaustive: takes hours, left out without --exhaustive")
    config.addinivalue_line("markers", "wall_clock: judged by this computer's clock, so nothing runs beside it")


def pytest_collection_modifyitems(config, items):
    wall_clock, exhaustive = config.getoption("--wall-clock"), config.getoption("--exhaustive")

    def runs(item):
        by_clock = item.get_closest_marker("wall_clock") is not None
        wanted = wall_clock == "with" or by_clock == (wall_clock == "only")
        return wanted and (exhaustive or not item.get_closest_marker("exhaustive"))

    left_out = [item for item in items if not runs(item)]
    items[:] = [item for item in items if item not in left_out]
    config.hook.pytest_deselected(items=left_out)


@pytest.fixture(scope="session", autouse=True)
def _default_signals():
    """A process that a test starts ends at a signal, also where the suite was started with it ignored.

    An ignored signal is inherited (nohup, a service, a job of a script); a caught one is not. So it is caught, by what
    does nothing: the suite itself goes on ignoring it.
    """
    ignored = [number for number in ENDING if signal.getsignal(number) == signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, lambda *_: None)
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
        yield


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    may_skip = hasattr(report, "wasxfail")
    if os.environ.get("CI") == "true" and report.skipped and not may_skip:
        report.outcome = "failed"
        report.longrepr = f"not run, and CI=true: {report.longrepr}"
    return report
