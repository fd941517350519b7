"""With CI=true what is not run is a failure: a skipped test fails, and says what it needs.

Tests that are marked exhaustive take hours; they are left out without --exhaustive.
Tests that are marked wall_clock are judged by the time of this computer, and need a processor for themselves; in those
that are marked lockstep no clock of this computer takes part, so they may be given what is left of one. tools/test.py
says which run of pytest takes which.
With --coverage the lines and branches that this process executes are recorded; `coverage report` prints them.
"""

import os
import signal
import sys
import tempfile

import pytest

# what the user's environment may say to a test; all other settings of mirrormount are taken out of it
KEPT = ("MIRRORMOUNT_CACHE", "MIRRORMOUNT_FUZZ_", "MIRRORMOUNT_IMAGES")
RECORDED = ("beam", "firmware", "host", "repo", "supervise", "tools")  # folders of tests that --coverage looks at
# processor time of which a test is recorded, all its cases together: after it come the same lines for other sessions,
# pictures or mounts, and recording makes them three to five times slower
RECORDED_S = 0.2
ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def pytest_addoption(parser):
    parser.addoption("--exhaustive", action="store_true", help="also cut the power at every operation of the flash")
    for option, kind in (("--wall-clock", "that need a processor for themselves"), ("--lockstep", "in lockstep")):
        parser.addoption(
            option,
            choices=["with", "without", "only"],
            default="with",
            help=f"tests {kind}: with all others, left out, or they alone",
        )
    parser.addoption("--coverage", action="store_true", help="record executed lines and branches in .cache/coverage")


def pytest_configure(config):
    if config.getoption("--coverage"):
        config.pluginmanager.register(Recorder(config), "recorder")
    config.addinivalue_line("markers", "exhaustive: takes hours, left out without --exhaustive")
    config.addinivalue_line("markers", "wall_clock: judged by this computer's clock, so one runs on each processor")
    config.addinivalue_line("markers", "lockstep: no clock of this computer takes part")


def pytest_collection_modifyitems(config, items):
    wanted = {name: config.getoption("--" + name.replace("_", "-")) for name in ("wall_clock", "lockstep")}
    exhaustive = config.getoption("--exhaustive")

    def runs(item):
        for name, choice in wanted.items():
            marked = item.get_closest_marker(name) is not None
            if choice != "with" and marked != (choice == "only"):
                return False
        return exhaustive or not item.get_closest_marker("exhaustive")

    left_out = [item for item in items if not runs(item)]
    items[:] = [item for item in items if item not in left_out]
    config.hook.pytest_deselected(items=left_out)


class Recorder:
    """Records the lines and branches that this process executes while it collects, and in the tests of RECORDED.

    With xdist the workers record, and the first process adds up their files.
    """

    def __init__(self, config):
        from coverage import Coverage

        self._adds_up = not hasattr(config, "workerinput")
        self._records = not (self._adds_up and config.getoption("numprocesses", None))
        self._left_s = {}  # of RECORDED_S, by the function of a test
        self._pauses = False
        (config.rootpath / ".cache").mkdir(exist_ok=True)
        self._coverage = Coverage(config_file=str(config.rootpath / "pyproject.toml"), data_suffix=True)
        if self._adds_up:
            self._coverage.erase()
        if self._records:
            self._coverage.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        if not self._records:
            return (yield)
        test = (item.path, getattr(item, "originalname", item.name))
        left_s = self._left_s.get(test, RECORDED_S) if item.path.parent.name in RECORDED else 0.0
        if left_s == 0:
            self._pause()
        self._alarm(left_s)
        try:
            return (yield)
        finally:
            self._left_s[test] = self._alarm(0)
            if self._pauses:
                self._pauses = False
                self._coverage.start()

    def _alarm(self, after_s):
        """Pause after that much processor time, 0: never. Returns what was left of the last alarm."""
        if not hasattr(signal, "setitimer"):  # Windows: all is recorded
            return RECORDED_S
        signal.signal(signal.SIGVTALRM, self._pause if after_s else signal.SIG_IGN)
        return signal.setitimer(signal.ITIMER_VIRTUAL, after_s)[0]

    def _pause(self, *_):
        self._pauses = True
        self._coverage.stop()

    def pytest_unconfigure(self):
        if self._records:
            self._coverage.stop()
            self._coverage.save()
        if self._adds_up:
            self._coverage.combine()
            self._coverage.save()


@pytest.fixture(autouse=True)
def _tracer_of_coverage():
    """The trace function of --coverage is set again after a test that sets its own."""
    tracer = sys.gettrace()
    yield
    if sys.gettrace() is not tracer:
        sys.settrace(tracer)


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
