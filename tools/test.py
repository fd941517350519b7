"""Check everything: lint, types and tests, from a fresh clone: python tools/test.py [--quick | --full] [-- ...]

--quick, 3 minutes: the firmware on CPython, the host in lockstep, the beam with rendered pictures.
Without an option, 15 minutes: also MicroPython's VM, boards in real time, a browser, the emulated RP2040, some fuzz.
--full, an hour: also every release, power cut and page, long fuzz, the coverage, and the times of the firmware.
Arguments after `--` go to pytest. Programs that are missing are installed by apt-get only with --install-system or
with CI=true in the environment; else they are listed, and the tests that need them are skipped. With CI=true a test
that was not run is a failure.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from typing import Dict, List, NamedTuple
from xml.etree import ElementTree

import _bootstrap as bootstrap

LOCK = "tests/requirements.txt"
MECHANICS_LOCK = "tools/mechanics/requirements.txt"  # for the tests of the printed parts as solids: with --full only
# packages of Debian: any of these programs or folders shows that it is there. The browser is for the panel, the rest
# for the emulated RP2040 and its MicroPython image
NEEDS = {
    "nodejs": ["node"],
    "npm": ["npm"],
    "gcc-arm-none-eabi": ["arm-none-eabi-gcc"],
    "libnewlib-arm-none-eabi": ["/usr/lib/arm-none-eabi/newlib", "/usr/include/newlib"],
    "libstdc++-arm-none-eabi-newlib": ["/usr/include/newlib/c++", "/usr/lib/arm-none-eabi/include/c++"],
    "cmake": ["cmake"],
    "make": ["make"],
    "gcc": ["gcc"],
    "dpkg-dev": ["dpkg-source"],
    "chromium": ["chromium", "chromium-browser", "google-chrome"],
}
IMPORTS = "from importlinter.cli import lint_imports_command as main; main()"  # it is no module that -m could run
CHECKS = {
    "lint": ["-m", "ruff", "check", "."],
    "format": ["-m", "ruff", "format", "--check", "."],
    "imports": ["-c", IMPORTS, "--no-cache", "--no-logo"],
    "types": ["-m", "basedpyright"],
}
# a file stays in one process: its tests share boards. Three for the two cores of CI: some tests wait for a process
PARALLEL = ["--numprocesses=3", "--dist=loadfile"]
QUICK = "not slow and not full and not wall_clock"
CLOCK = "tests tied to the wall clock"  # one after the other, with nothing beside them
LEVELS = {
    "quick": {"tests": ["-m", "pytest", *PARALLEL, "-m", QUICK]},
    "default": {
        "tests": ["-m", "pytest", *PARALLEL, "-m", "not full and not wall_clock"],
        CLOCK: ["-m", "pytest", "-m", "not full and wall_clock"],
    },
    "full": {
        # recorded are the quick tests: the others spend their time in programs of their own, or in lines seen before
        "tests with coverage": ["-m", "coverage", "run", "-m", "pytest", "-m", QUICK],
        "other tests": ["-m", "pytest", *PARALLEL, "-m", "(slow or full) and not wall_clock"],
        CLOCK: ["-m", "pytest", "-m", "wall_clock"],
        "coverage": ["-m", "coverage", "report"],
        "times": ["tools/bench/run.py", "--check", "--quick"],
    },
}
LONG_FUZZ = {
    "MIRRORMOUNT_FUZZ_EXAMPLES": "300",
    "MIRRORMOUNT_FUZZ_SESSIONS": "100000",
    "MIRRORMOUNT_FUZZ_LANE_SESSIONS": "100000",
}  # with --full
NO_TESTS = 5  # pytest's status when it has nothing to run


class Result(NamedTuple):
    """How one check ended. tests: how many passed, failed, were skipped; of pytest only."""

    title: str
    status: int
    seconds: float
    tests: Dict[str, int]


def missing() -> List[str]:
    """The packages that this machine has not."""
    there = {p: any(os.path.isdir(w) if w[0] == "/" else shutil.which(w) for w in ways) for p, ways in NEEDS.items()}
    return [package for package, is_there in there.items() if not is_there]


def counted(report: str) -> Dict[str, int]:
    """How many tests passed, failed and were skipped, by pytest's report; {} if it wrote none."""
    if not os.path.exists(report):
        return {}
    suites = [suite.attrib for suite in ElementTree.parse(report).getroot().iter("testsuite")]
    total, skipped = (sum(int(suite[name]) for suite in suites) for name in ("tests", "skipped"))
    failed = sum(int(suite["failures"]) + int(suite["errors"]) for suite in suites)
    return {"passed": total - failed - skipped, "failed": failed, "skipped": skipped}


def check(step: str, title: str, words: List[str], environment: Dict[str, str]) -> Result:
    """Run one check under its title."""
    bootstrap.say(f"\n[{step}] {title}")
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        report = os.path.join(folder, "report.xml")
        more = ["--junit-xml", report] if "pytest" in words else []
        status = bootstrap.call([str(bootstrap.PYTHON), *words, *more], environment=environment)
        return Result(title, status, time.monotonic() - start, counted(report))


def main(arguments: List[str]) -> int:
    """Prepare .venv, run every check even if one fails, sum up; the count of tests is the last line."""
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    for_pytest, ci = arguments[cut + 1 :], os.environ.get("CI", "").lower() == "true"
    parser = argparse.ArgumentParser(
        usage="tools/test.py [--quick | --full] [--install-system] [-- ...]",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    level = parser.add_mutually_exclusive_group()
    level.add_argument("--quick", dest="level", action="store_const", const="quick", default="default")
    level.add_argument("--full", dest="level", action="store_const", const="full")
    parser.add_argument("--install-system", action="store_true", help="let apt-get install what is missing")
    options = parser.parse_args(arguments[:cut])
    may_install = options.install_system or ci
    absent = missing() if options.level != "quick" else []
    if absent and may_install:
        try:
            bootstrap.apt_install(absent)
        except bootstrap.Stop as stop:
            bootstrap.say(str(stop))
        absent = missing()
    if absent:
        bootstrap.say("Tests that need these are skipped. To run them: sudo apt install " + " ".join(absent))
    bootstrap.prepare("tests", LOCK, may_install)
    if options.level == "full":
        bootstrap.prepare("mechanics", MECHANICS_LOCK, may_install)
    runs = LEVELS[options.level].items()
    if for_pytest:  # of some tests no coverage counts
        runs = [(title, [*words, *for_pytest]) for title, words in runs if "pytest" in words]
    todo = {**CHECKS, **dict(runs)}
    environment = {k: os.environ.get(k, v) for k, v in LONG_FUZZ.items()} if options.level == "full" else {}
    results = []
    for number, (title, words) in enumerate(todo.items(), 1):
        results.append(check(f"{number}/{len(todo)}", title, words, environment))
    counts = {name: sum(r.tests.get(name, 0) for r in results) for name in ("passed", "failed", "skipped")}
    if any(counts.values()):  # then a run that had nothing to do is none that failed
        results = [r._replace(status=0) if r.status == NO_TESTS and not any(r.tests.values()) else r for r in results]
    lines = [f"{'FAILED' if r.status else 'ok':8} {r.title} ({r.seconds:.0f} s)" for r in results]
    if absent:
        lines.append(f"{'FAILED' if ci else 'not run':8} what needs: sudo apt install {' '.join(absent)}")
    bootstrap.say("\nSummary\n  " + "\n  ".join(lines))
    bootstrap.say(", ".join(f"{count} {name}" for name, count in counts.items()))
    return int(any(r.status for r in results) or (ci and bool(absent)))


if __name__ == "__main__":
    sys.exit(bootstrap.guarded(main))
