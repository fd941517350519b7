"""Command lines of child Pythons. Imports nothing of ours."""

import sys


def python_module(name: str, *arguments: str) -> list[str]:
    """The command that runs an installed module as `python -m name` would.

    -P: without it Python searches the current folder first, where a file of that name would be run instead.
    """
    return [sys.executable, "-P", "-m", name, *arguments]
