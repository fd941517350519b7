"""Check everything: lint, types and every test, from a fresh clone: python tools/test.py

Makes .venv and installs the locked tools of tests/requirements.txt there.  Arguments after `--` go to pytest.
pytest runs twice: four processes share the tests that the wall clock cannot fail; then one runs the others.
Without arguments for pytest the first run records the coverage, which is printed at the end, and a third runs beside
the second, with what that leaves of the processors: the tests in lockstep, which no clock of this computer judges.
System packages are installed only with --install-system or with CI=true in the environment; otherwise the
missing ones are listed, with what is not run without them.  With CI=true, anything not run is a failure.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from typing import Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple, Union
from xml.etree import ElementTree

import _bootstrap as bootstrap
import _programs as programs


def _has_arm_libc() -> bool:
    return os.path.isdir("/usr/lib/arm-none-eabi/newlib") or os.path.isdir("/usr/include/newlib")


def _has_arm_cpp() -> bool:
    return os.path.isdir("/usr/include/newlib/c++") or os.path.isdir("/usr/lib/arm-none-eabi/include/c++")


class Need(NamedTuple):
    """Something pip cannot install, and what cannot be run without it."""

    check: Union[str, Callable[[], bool]]  # a command that must be on PATH, or a function that finds out
    package: str  # of Debian and Ubuntu
    purpose: str
    not_run: Tuple[str, ...]  # tests, as pytest names them: a folder, a file or file::test


def _has_browser() -> bool:
    return any(shutil.which(name) for name in ("chromium", "chromium-browser", "google-chrome"))


_EMULATED = ("tests/emulated",)
_IN_A_BROWSER = tuple(
    f"tests/panel/test_{name}.py"
    for name in ("driving", "safety", "auth", "cards", "looks", "foreign_pages", "third_axis", "control")
)
NEEDS: Tuple[Need, ...] = (
    Need("node", "nodejs", "runs the emulated RP2040", _EMULATED),
    Need("npm", "npm", "installs the emulator's core", _EMULATED),
    Need("arm-none-eabi-gcc", "gcc-arm-none-eabi", "builds its MicroPython image", _EMULATED),
    Need(_has_arm_libc, "libnewlib-arm-none-eabi", "builds its MicroPython image", _EMULATED),
    Need(_has_arm_cpp, "libstdc++-arm-none-eabi-newlib", "builds its MicroPython image", _EMULATED),
    Need("cmake", "cmake", "builds its MicroPython image", _EMULATED),
    Need("make", "make", "builds its MicroPython image", _EMULATED),
    Need("gcc", "gcc", "builds its MicroPython image", _EMULATED),
    Need("dpkg-source", "dpkg-dev", "unpacks the image's sources", _EMULATED),
    Need(_has_browser, "chromium", "is the browser in front of the panel", _IN_A_BROWSER),
)

WANTED = bootstrap.Wanted(
    purpose="tests",
    pip_arguments=[*bootstrap.locked("tests/requirements.txt"), bootstrap.OURSELVES],
    files=["tests/requirements.txt", "pyproject.toml", "firmware_py/mountfw/__init__.py"],
    modules=["serial", "numpy", "matplotlib", "pytest", "hypothesis", "schemdraw", "mpremote", "nicegui", "playwright"],
)

# a file stays in one process: its tests share boards; in the order of folders, the longest files come first
# more processes than the two cores of CI, for tests wait for boards in real time; with five, some waited in vain
PARALLEL = ("--numprocesses=4", "--dist=loadfile", "--no-loadscope-reorder")
CLOCK = "tests tied to the wall clock"
CHECKS = (
    ("lint", ["ruff", "check", "."]),
    ("format", ["ruff", "format", "--check", "."]),
    ("imports", ["lint-imports", "--no-cache", "--no-logo"]),
    ("types", ["basedpyright"]),
    ("tests", ["pytest", "--wall-clock=without", *PARALLEL]),
    (CLOCK, ["pytest", "--wall-clock=only"]),
    ("coverage", ["coverage", "report"]),
)
# in a whole run, one after the other beside the first run of pytest: what reads the code only
READ_ONLY = ("lint", "format", "imports", "types")
# in a whole run beside the first, and the second: a firmware that got slower (docs/performance.md) fails. Emulated time
# does not depend on what it is given, so it takes what is left (POSIX)
TIMES = ("times", ["tools/bench/run.py", "--check", "--quick", "--jobs", "1"])
# in a whole run beside the second, after the above: tests that have all the time of the world. What the second leaves
# is about one processor: the power cuts, which need it for five minutes, stay in the first
LOCKSTEP = (
    "tests in lockstep",
    [
        "pytest",
        "tests/emulated",
        "tests/fuzz",
        "--lockstep=only",
        "--numprocesses=2",
        "--dist=loadfile",
        "--no-loadscope-reorder",
        "--color=no",
    ],
)
RECORD = "--coverage"  # pytest's argument in the first run: the second is judged by the clock, which recording slows
NO_TESTS = 5  # pytest's status when it has nothing to run
COUNTS = ("passed", "failed", "skipped")


class Result(NamedTuple):
    """How one check ended."""

    title: str
    status: int
    seconds: float
    tests: Optional[Dict[str, int]] = None  # how many passed, failed, were skipped; of pytest only


def parse(arguments: List[str]) -> Tuple[bool, List[str]]:
    """Whether system packages may be installed, and what is for pytest."""
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    parser = argparse.ArgumentParser(usage="tools/test.py [--install-system] [-- ...]", description=__doc__)
    parser.add_argument("--install-system", action="store_true", help="let apt-get install what is missing")
    return parser.parse_args(arguments[:cut]).install_system, arguments[cut + 1 :]


def missing(needs: Sequence[Need]) -> List[Need]:
    """The needs that this machine does not meet."""
    return [n for n in needs if not (shutil.which(n.check) if isinstance(n.check, str) else n.check())]


def settle(needs: Sequence[Need], may_install: bool, run: programs.Run = programs.run) -> List[Need]:
    """Install what is missing if that is allowed; what is still missing afterwards, said on the screen."""
    absent = missing(needs)
    if absent and may_install:
        programs.say("Installing system packages: " + packages_of(absent))
        try:
            bootstrap.apt_install(packages_of(absent).split(), run)
        except programs.Stop as stop:
            programs.say(str(stop))
        absent = missing(absent)
    for need in absent:
        programs.say(f"Missing: {need.package} ({need.purpose}); not run: {', '.join(need.not_run)}")
    if absent:
        programs.say("To install: sudo apt install " + packages_of(absent))
    return absent


def packages_of(needs: Sequence[Need]) -> str:
    """The packages of some needs, once each, as apt takes them."""
    return " ".join(dict.fromkeys(need.package for need in needs))


def chosen(for_pytest: List[str], ci: bool) -> List[Tuple[str, List[str]]]:
    """The checks. Of some tests no coverage is recorded; its floor counts with CI=true, where no test is skipped."""
    if for_pytest:
        return [(title, [*words]) for title, words in CHECKS if title != "coverage"]
    added = {"tests": ["--lockstep=without", RECORD], "coverage": [] if ci else ["--fail-under=0"]}
    return [(title, [*words, *added.get(title, [])]) for title, words in CHECKS]


def check(step: str, title: str, words: List[str]) -> Result:
    """Run one check under its title."""
    programs.say(f"\n[{step}] {title}: {' '.join(words)}")
    start = time.monotonic()
    if words[0] != "pytest":
        status, output = programs.run(command_of(words))
        if output.strip():
            programs.say(output.rstrip())
        return Result(title, status, time.monotonic() - start)
    with tempfile.TemporaryDirectory() as folder:
        report = os.path.join(folder, "report.xml")
        status = programs.show_quietly_ended([*command_of(words), "--junit-xml", report])
        return Result(title, status, time.monotonic() - start, counted(report))


def check_last(title: str, words: List[str]) -> Result:
    """Run one check after everything else that wants a processor; its output comes at its end."""
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        report = os.path.join(folder, "report.xml")
        more = ["--junit-xml", report] if words[0] == "pytest" else []
        status, output = programs.run([*command_of(words), *more], last=True)
        programs.say(f"\n{title}: {' '.join(words)}\n{output.rstrip()}")
        return Result(title, status, time.monotonic() - start, counted(report))


def command_of(words: List[str]) -> List[str]:
    """A check's command line: a script, or a module of the .venv."""
    python = programs.venv_python(programs.ROOT / ".venv")
    if words[0] == "lint-imports":  # cannot be run as a module: its script lies beside the Python that it is for
        return [str(python.parent / words[0]), *words[1:]]
    return [str(python), *([] if words[0].endswith(".py") else ["-m"]), *words]


def counted(report: str) -> Optional[Dict[str, int]]:
    """How many tests passed, failed and were skipped, by pytest's report; None if it wrote none."""
    if not os.path.exists(report):
        return None
    suites = [suite.attrib for suite in ElementTree.parse(report).getroot().iter("testsuite")]
    total, skipped = (sum(int(suite[name]) for suite in suites) for name in ("tests", "skipped"))
    failed = sum(int(suite["failures"]) + int(suite["errors"]) for suite in suites)
    return {"passed": total - failed - skipped, "failed": failed, "skipped": skipped}


def judged(results: Sequence[Result]) -> List[Result]:
    """The results, where a run of pytest without a test is no failure if another run had one."""
    if not any(r.tests and any(r.tests.values()) for r in results):
        return list(results)
    return [r._replace(status=0) if r.status == NO_TESTS and r.title.startswith("tests") else r for r in results]


def summary(results: Sequence[Result], absent: Sequence[Need], ci: bool) -> Tuple[List[str], int]:
    """The closing lines, the count of tests last, and the exit status; on CI, what was not run counts as failed."""
    lines = [f"{'FAILED' if r.status else 'ok':8} {r.title} ({r.seconds:.1f} s)" for r in results]
    for need in absent:
        word = "FAILED" if ci else "not run"
        lines.append(f"{word:8} {', '.join(need.not_run)} (needs {need.package})")
    if absent:
        lines.append("To run everything: sudo apt install " + packages_of(absent))
    lines.append(", ".join(f"{sum(r.tests[name] for r in results if r.tests)} {name}" for name in COUNTS))
    return lines, int(any(r.status for r in results) or (ci and bool(absent)))


def main(arguments: List[str]) -> int:
    """Prepare .venv, run every check even if one fails, sum up."""
    bootstrap.ensure_python(__file__, arguments)
    install_system, for_pytest = parse(arguments)
    ci = os.environ.get("CI", "").lower() == "true"
    absent = settle(NEEDS, may_install=install_system or ci)
    to_do = chosen(for_pytest, ci)
    steps = len(to_do) + 2
    bootstrap.prepare(programs.ROOT, WANTED, steps, may_install=install_system or ci)
    deselected = ["--deselect=" + name for need in absent for name in need.not_run]
    with_times = not for_pytest and not any(need.not_run == _EMULATED for need in absent)
    results: List[Result] = []
    with programs.Beside() as pool:
        beside = []
        for number, (title, words) in enumerate(to_do, 3):
            extra = [*deselected, *for_pytest] if words[0] == "pytest" else []
            if not for_pytest and title in READ_ONLY:
                beside.append(pool.submit(check, f"{number}/{steps}", title, words))
                continue
            if title == "tests" and with_times:
                beside.append(pool.submit(check_last, *TIMES))
            if title == CLOCK and not for_pytest:
                beside.append(pool.submit(check_last, LOCKSTEP[0], [*LOCKSTEP[1], *extra]))
            results.append(check(f"{number}/{steps}", title, [*words, *extra]))
        results[:0] = [work.result() for work in beside]
    lines, status = summary(judged(results), absent, ci)
    programs.say("\nSummary\n  " + "\n  ".join(lines[:-1]) + "\n" + lines[-1])
    return status


if __name__ == "__main__":
    sys.exit(programs.guarded(main))
