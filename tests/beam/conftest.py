"""The table of the tests of scans."""

import contextlib

import pytest

from mirrormount.transport.open import open_table


@pytest.fixture
def table():
    with contextlib.closing(open_table("virtual-table://?mounts=1&cameras=2")) as opened:
        yield opened
