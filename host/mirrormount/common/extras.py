"""How to install an optional part of mirrormount, in words. Imports nothing of ours."""

import os
import shutil
import sys
from pathlib import Path


def install(extra: str) -> str:
    """The command that installs an extra: from the copy of the repository that this package belongs to, if it does.

    It is for the Python that runs: a bare `pip` may be another one's.
    """
    copy = Path(__file__).parents[3]
    if (copy / "pyproject.toml").is_file():
        return f'{_this_python()} -m pip install -e "{copy}[{extra}]"'
    return f'in a copy of the repository: {_this_python()} -m pip install ".[{extra}]"'


def _this_python() -> str:
    """The Python that runs, as a shell is told it: `python` if that is found first, else its path."""
    here, found = sys.executable or "python", shutil.which("python")
    if found and os.path.normcase(os.path.abspath(found)) == os.path.normcase(os.path.abspath(here)):
        return "python"
    if Path(here).is_relative_to(Path.cwd()):
        here = str(Path(here).relative_to(Path.cwd()))
    return f'"{here}"' if " " in here else here
