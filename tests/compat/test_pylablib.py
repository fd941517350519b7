"""pylablib's Picomotor8742 on served virtual boards: what pins and positions do. The checks are in tools/compat."""

import os
from collections.abc import Iterator

import pytest

pytest.importorskip("pylablib", reason="pylablib-lightweight is not installed here")
pytest.register_assert_rewrite("driver_pylablib")

import driver_pylablib  # noqa: E402
from checks import Check, Trial, trial  # noqa: E402
from place import MACHINES, WAYS  # noqa: E402

pytestmark = pytest.mark.skipif(os.name != "posix", reason="a pty needs POSIX")


PLACES = [(way, machine) for machine in MACHINES for way in WAYS]
CHECKS = driver_pylablib.CHECKS
QUICK = [check for check in CHECKS if not check.slow]


def name(check: Check) -> str:
    return check.name


@pytest.fixture(scope="module")
def place(request) -> Iterator[Trial]:
    way, machine = request.param
    with trial(driver_pylablib, way, machine) as opened:
        yield opened


@pytest.mark.parametrize("place", PLACES, indirect=True, ids="-".join)
@pytest.mark.parametrize("check", [c for c in QUICK if c.ways == WAYS], ids=name)
def test_with_pylablib(place, check):
    place.run(check)


@pytest.mark.parametrize("place", [place for place in PLACES if "tcp" in place], indirect=True, ids="-".join)
@pytest.mark.parametrize("check", [c for c in QUICK if c.ways == ("tcp",)], ids=name)
def test_with_pylablib_over_tcp(place, check):
    place.run(check)


@pytest.mark.parametrize("place", [("tcp", "micropython")], indirect=True, ids="-".join)
@pytest.mark.parametrize("check", [c for c in CHECKS if c.slow], ids=name)
def test_with_pylablib_what_takes_long(place, check):
    place.run(check)
