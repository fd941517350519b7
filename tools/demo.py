"""Show mirrormount at work, with nothing but Python on the machine: python tools/demo.py

Makes .venv, installs mirrormount and its plots there, and runs `mirrormount demo` on the virtual board.
Arguments are passed on to `mirrormount demo`; the exit status is its own.
"""

from __future__ import annotations

import sys
from typing import List

import _bootstrap as bootstrap

LOCK = "tools/demo-requirements.txt"


def main(arguments: List[str]) -> int:
    """Prepare .venv, then run the demo in the caller's folder; without a screen, so that plots go to files."""
    bootstrap.prepare("demo", LOCK)
    command = [str(bootstrap.PYTHON), "-P", "-m", "mirrormount", "demo", *arguments]
    return bootstrap.call(command, cwd=None, environment={"MPLBACKEND": "Agg"})


if __name__ == "__main__":
    sys.exit(bootstrap.guarded(main))
