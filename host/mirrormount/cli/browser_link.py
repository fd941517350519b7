"""A link with a secret, as a file that leads a browser there: every user can read the arguments of a process."""

import contextlib
import html
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

_PAGE = """<!doctype html><meta charset=utf-8><title>mirrormount</title>
<meta http-equiv=refresh content="0; url={0}"><a href="{0}">the panel</a>
"""


@contextlib.contextmanager
def page_to(link: str) -> Iterator[str]:
    """The address of a page that leads to the link. Only this user can read it; it is removed at the end.

    A link without a fragment has no secret, and is returned as it is. Raises OSError.
    """
    if "#" not in link:
        yield link
        return
    descriptor, name = tempfile.mkstemp(prefix="mirrormount-", suffix=".html")  # mode 600
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as page:
            page.write(_PAGE.format(html.escape(link)))
        yield Path(name).as_uri()
    finally:
        Path(name).unlink(missing_ok=True)
