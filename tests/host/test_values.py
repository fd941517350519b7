"""What counts as a number: what is one by its value."""

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from mirrormount.device.mount import Mount
from mirrormount.errors import BadValue
from mirrormount.values import real_number, typed_number, whole_number


@pytest.mark.parametrize("value", [5, 5.0, np.int64(5), np.uint8(5), np.float32(5), Decimal(5), Fraction(10, 2)])
def test_what_is_whole_by_its_value_is_a_whole_number(value):
    number = whole_number(value, 10, "n")
    assert number == 5 and type(number) is int


@pytest.mark.parametrize(
    "value", [True, False, np.True_, "5", b"5", None, 5.5, np.float64("nan"), 5j, [5], np.array([5])]
)
def test_what_is_no_whole_number_is_refused(value):
    with pytest.raises(BadValue, match="n is a whole number, not"):
        whole_number(value, 10, "n")


@pytest.mark.parametrize("value", [True, "0.5", None, float("nan"), float("inf"), 5j, np.array([0.5])])
def test_what_is_no_number_is_refused(value):
    with pytest.raises(BadValue, match="p is a number, not"):
        real_number(value, 10, "p")


@pytest.mark.parametrize("text", ["1_000", "1_0.5", "\u0661", "five", "", "5mm"])
def test_what_no_person_types_as_a_number_is_refused(text):
    with pytest.raises(BadValue, match="p is a number, not"):
        typed_number(text, "p")


@pytest.mark.parametrize("text", ["1e-400", "-0.01E-330", "0." + "0" * 400 + "1"])
def test_a_number_that_would_become_0_is_refused(text):
    with pytest.raises(BadValue, match="p is nearer to 0 than"):
        typed_number(text, "p")


@pytest.mark.parametrize("position", [float("nan"), float("inf"), "5", None, 1_000_001])
def test_the_way_to_what_is_no_position_is_refused(position):
    with Mount.open("virtual://?speed=max") as mount, pytest.raises(BadValue):
        mount.x.parts_to(position)


def test_0_is_0_however_it_is_typed():
    assert [typed_number(text, "p") for text in ("0", "-0.0", "0e5", "+.0E-9")] == [0, 0, 0, 0]


def test_a_number_is_whole_if_its_value_is():
    assert type(real_number(np.float64(3), 10, "p")) is int
    assert real_number(np.float32(0.5), 10, "p") == 0.5
    for value in (10.5, -11, np.int64(11)):
        with pytest.raises(BadValue, match="within -10 … 10"):
            real_number(value, 10, "p")
