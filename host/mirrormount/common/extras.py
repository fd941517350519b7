"""How to install an optional part of mirrormount, in words. Imports nothing."""

from pathlib import Path


def install(extra: str) -> str:
    """The command that installs an extra: from the copy of the repository that this package belongs to, if it does."""
    copy = Path(__file__).parents[3]
    if (copy / "pyproject.toml").is_file():
        return f'pip install -e "{copy}[{extra}]"'
    return f'in a copy of the repository: pip install ".[{extra}]"'
