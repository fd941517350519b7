"""Check everything: lint, types and every test, from a fresh clone: python tools/test.py

Makes .venv and installs the locked tools of tests/requirements.txt there.  Arguments after `--` go to pytest.
System packages are installed only with --install-system or with CI=true in the environment; otherwise the
missing ones are listed, with what is not run without them.  With CI=true, anything not run is a failure.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from typing import Callable, List, NamedTuple, Sequence, Tuple, Union

import _bootstrap as bootstrap


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
_IN_A_BROWSER = tuple(f"tests/panel/test_{name}.py" for name in ("driving", "safety", "door", "cards"))
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
    pip_arguments=[["--no-deps", "-r", "tests/requirements.txt"], ["--no-deps", "-e", "."]],
    files=["tests/requirements.txt", "pyproject.toml", "firmware_py/mountfw/__init__.py"],
    modules=["serial", "numpy", "matplotlib", "pytest", "hypothesis", "schemdraw", "mpremote", "nicegui", "playwright"],
)

# pytest stays last, so that its own count of passed tests is the last thing above the summary
CHECKS = (
    ("lint", ["ruff", "check", "."]),
    ("format", ["ruff", "format", "--check", "."]),
    ("types", ["basedpyright"]),
    ("tests", ["pytest"]),
)


class Result(NamedTuple):
    """How one check ended."""

    title: str
    status: int
    seconds: float


def parse(arguments: List[str]) -> Tuple[bool, List[str]]:
    """Whether system packages may be installed, and what is for pytest."""
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    parser = argparse.ArgumentParser(usage="tools/test.py [--install-system] [-- ...]", description=__doc__)
    parser.add_argument("--install-system", action="store_true", help="let apt-get install what is missing")
    return parser.parse_args(arguments[:cut]).install_system, arguments[cut + 1 :]


def missing(needs: Sequence[Need]) -> List[Need]:
    """The needs that this machine does not meet."""
    return [n for n in needs if not (shutil.which(n.check) if isinstance(n.check, str) else n.check())]


def settle(needs: Sequence[Need], may_install: bool, run: bootstrap.Run = bootstrap.run) -> List[Need]:
    """Install what is missing if that is allowed; what is still missing afterwards, said on the screen."""
    absent = missing(needs)
    if absent and may_install:
        bootstrap.say("Installing system packages: " + packages_of(absent))
        try:
            bootstrap.apt_install(packages_of(absent).split(), run)
        except bootstrap.Stop as stop:
            bootstrap.say(str(stop))
        absent = missing(absent)
    for need in absent:
        bootstrap.say(f"Missing: {need.package} ({need.purpose}); not run: {', '.join(need.not_run)}")
    if absent:
        bootstrap.say("To install: sudo apt install " + packages_of(absent))
    return absent


def packages_of(needs: Sequence[Need]) -> str:
    """The packages of some needs, once each, as apt takes them."""
    return " ".join(dict.fromkeys(need.package for need in needs))


def check(number: int, title: str, words: List[str]) -> Result:
    """Run one check under its title."""
    bootstrap.say(f"\n[{number}/{len(CHECKS) + 2}] {title}: {' '.join(words)}")
    python = str(bootstrap.venv_python(bootstrap.ROOT / ".venv"))
    start = time.monotonic()
    status = bootstrap.show([python, "-m", *words], cwd=bootstrap.ROOT, stdin=subprocess.DEVNULL)
    if status == 130:
        raise KeyboardInterrupt
    return Result(title, status, time.monotonic() - start)


def summary(results: Sequence[Result], absent: Sequence[Need], ci: bool) -> Tuple[List[str], int]:
    """The closing lines and the exit status; on CI, what was not run counts as failed."""
    lines = [f"{'FAILED' if r.status else 'ok':8} {r.title} ({r.seconds:.1f} s)" for r in results]
    for need in absent:
        word = "FAILED" if ci else "not run"
        lines.append(f"{word:8} {', '.join(need.not_run)} (needs {need.package})")
    if absent:
        lines.append("To run everything: sudo apt install " + packages_of(absent))
    return lines, int(any(r.status for r in results) or (ci and bool(absent)))


def main(arguments: List[str]) -> int:
    """Prepare .venv, run every check even if one fails, sum up."""
    bootstrap.ensure_python(__file__, arguments)
    install_system, for_pytest = parse(arguments)
    ci = os.environ.get("CI", "").lower() == "true"
    absent = settle(NEEDS, may_install=install_system or ci)
    bootstrap.prepare(bootstrap.ROOT, WANTED, len(CHECKS) + 2, may_install=install_system or ci)
    deselected = ["--deselect=" + name for need in absent for name in need.not_run]
    results = []
    for number, (title, words) in enumerate(CHECKS, 3):
        extra = [*deselected, *for_pytest] if words[0] == "pytest" else []
        results.append(check(number, title, [*words, *extra]))
    lines, status = summary(results, absent, ci)
    bootstrap.say("\nSummary\n  " + "\n  ".join(lines))
    return status


if __name__ == "__main__":
    sys.exit(bootstrap.guarded(main))
