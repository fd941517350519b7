"""JSON from files that somebody else may have written: it is read, or a ValueError. Imports nothing of ours."""

import json
from pathlib import Path
from typing import Any

MOST = 1 << 20  # bytes of a file


def read(path: Path) -> Any:
    """The content of a file. Raises OSError, and ValueError if it is no JSON or more than MOST bytes."""
    with path.open("rb") as file:
        content = file.read(MOST + 1)
    if len(content) > MOST:
        raise ValueError(f"more than {MOST} bytes")
    return loads(content)


def loads(text: str | bytes) -> Any:
    """json.loads(), but text that is nested too deeply is a ValueError as well."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None
