"""With CI=true what is not run is a failure: a skipped test fails, and says what it needs.

Tests that are marked given need a file that only a user can give: they alone may be skipped there, too.
Tests that are marked exhaustive take hours; they are left out without --exhaustive.
"""

import os
import tempfile

import pytest


def pytest_addoption(parser):
    parser.addoption("--exhaustive", action="store_true", help="also cut the power at every operation of the flash")


def pytest_configure(config):
    # `mirrormount stop` stops what this user has open: only what the tests have
    runtime = tempfile.TemporaryDirectory(prefix="mm-")
    os.environ["XDG_RUNTIME_DIR"] = runtime.name
    config.add_cleanup(runtime.cleanup)
    config.addinivalue_line("markers", "exhaustive: takes hours, left out without --exhaustive")
    config.addinivalue_line("markers", "given: needs a file that nothing fetches or builds, so CI may skip it")


def pytest_collection_modifyitems(config, items):
    if not config.getoption("--exhaustive"):
        left_out = [item for item in items if item.get_closest_marker("exhaustive")]
        items[:] = [item for item in items if item not in left_out]
        config.hook.pytest_deselected(items=left_out)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    may_skip = hasattr(report, "wasxfail") or item.get_closest_marker("given")
    if os.environ.get("CI") == "true" and report.skipped and not may_skip:
        report.outcome = "failed"
        report.longrepr = f"not run, and CI=true: {report.longrepr}"
    return report
