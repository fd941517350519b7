"""Words in the address of a virtual board or table: numbers, profiles. Every refusal is one line."""

import math
from dataclasses import replace

from mirrormount.common.errors import BadAddress, BadValue
from mirrormount.common.validation import digits, typed_number
from mirrormount.virtual.bench import Order
from mirrormount.virtual.encoder import FAULTS
from mirrormount.virtual.profile import PROFILES, Profile

_MOST_S = 1e6
MOST_SEED = (1 << 32) - 1
LEAST_SUPPLY, MOST_SUPPLY = 0.3, 1.5  # of the nominal voltage: below, a gearmotor stands still


def profile_named(name: str, supply: str | None = None) -> Profile:
    """The profile of that name, with the supply that a person has typed. Raises BadAddress."""
    if name not in PROFILES:
        raise BadAddress(f"there is no profile {name!r}: choose one of {', '.join(PROFILES)}")
    profile = PROFILES[name]
    if supply is None:
        return profile
    try:
        value = typed_number(supply, "supply")
    except ValueError:
        value = math.nan
    if not LEAST_SUPPLY <= value <= MOST_SUPPLY:
        raise BadAddress(f"supply is within {LEAST_SUPPLY} … {MOST_SUPPLY} of the nominal voltage, not {supply[:80]!r}")
    return replace(profile, supply=value)


def seed_of(text: str) -> int:
    """The seed that a person has typed. Raises BadAddress."""
    try:
        return digits(text, MOST_SEED)
    except BadValue:
        raise BadAddress(f"a seed is a number, 0 to {MOST_SEED}, not {text[:80]!r}") from None


def orders_of(text: str) -> tuple[Order, ...]:
    """The faults that a person has ordered, NAME@SECONDS after commas, of m1 and m2 unless one is named: m1:NAME.

    Raises BadAddress.
    """
    orders: list[Order] = []
    for word in filter(None, text.split(",")):
        motor, _, rest = word.rpartition(":")
        name, at, seconds = rest.partition("@")
        try:
            begins_s = typed_number(seconds, "a fault's time") if at else 0.0
        except ValueError:
            begins_s = math.nan
        if name not in FAULTS or motor not in ("", "m1", "m2") or not 0 <= begins_s <= _MOST_S:
            raise BadAddress(
                f"a fault is one of {', '.join(FAULTS)}, as in fault=broken, fault=broken@5 (after 5 s) or"
                f" fault=m1:broken@5, not {word[:80]!r}"
            )
        orders += [Order(name, which, round(begins_s * 1e6)) for which in ([motor] if motor else ["m1", "m2"])]
    return tuple(orders)
