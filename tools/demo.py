"""Show mirrormount at work, with nothing but Python on the machine: python tools/demo.py

Makes .venv, installs mirrormount and its plots there, and runs `mirrormount demo` on the virtual board.
Arguments are passed on to `mirrormount demo`; the exit status is its own.
"""

from __future__ import annotations

import sys

import _bootstrap as bootstrap
import _programs as programs

WANTED = bootstrap.Wanted(
    purpose="demo",
    pip_arguments=[*bootstrap.locked("tools/demo-requirements.txt"), bootstrap.OURSELVES],
    files=["tools/demo-requirements.txt", "pyproject.toml", "firmware_py/mountfw/__init__.py"],
    modules=["serial", "numpy", "matplotlib"],
)


def main(arguments: list[str]) -> int:
    """Prepare .venv, then run the demo; without a screen, so that plots go to files."""
    bootstrap.ensure_python(__file__, arguments)
    bootstrap.prepare(programs.ROOT, WANTED, steps=3)
    programs.say("[3/3] running the demo …")
    python = str(programs.venv_python(programs.ROOT / ".venv"))
    return programs.show([python, "-P", "-m", "mirrormount", "demo", *arguments], MPLBACKEND="Agg")


if __name__ == "__main__":
    sys.exit(programs.guarded(main))
