"""The mechanics of a virtual mount: `smooth`, which is kind, and `rough`, which is a mount of hobby parts.

Every number of `rough` is assumed: a trial on paper-size models found its results insensitive to them. `smooth` gives
the paper's figures. docs/virtual-board.md has both in one table.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Profile:
    """What differs between kind and real mechanics. Fractions are of 1, times in seconds."""

    name: str
    pulse_noise: float  # relative spread of the speed from pulse to pulse, one standard deviation
    short_noise: float = 0.0  # further spread of a pulse of length 0 ...
    short_s: float = 0.02  # ... which fades with the pulse's length T as exp(-T / short_s)
    breakaway_s: float = 0.0  # from the begin of a drive at rest to the first motion: mean ...
    breakaway_spread_s: float = 0.0  # ... and standard deviation
    negative_slower: float = 0.0  # how much slower the negative direction is
    periodic: float = 0.0  # amplitude of the mirror's speed over one turn of the screw
    gap_spread: float = 0.0  # relative spread of the gap from reversal to reversal
    loose_start: bool = False  # the shaft starts anywhere in the gap, not in its middle
    creep: float = 0.0  # share of a motion that comes later ...
    creep_s: float = 1.0  # ... with this time constant
    supply: float = 1.0  # the motors' voltage, of the nominal one: the speed is proportional to it

    def warped(self, screw_rev: float, phase_rad: float) -> float:
        """The turn, in revolutions, to which the mirror has followed a screw with a periodic error."""
        if not self.periodic:
            return screw_rev
        turn = 2 * math.pi
        wave = math.sin(turn * screw_rev + phase_rad) - math.sin(phase_rad)
        return screw_rev + self.periodic / turn * wave


SMOOTH = Profile("smooth", pulse_noise=0.005)  # assumed
ROUGH = Profile(
    "rough",
    pulse_noise=0.05,
    short_noise=0.25,
    breakaway_s=3e-3,
    breakaway_spread_s=1.5e-3,
    negative_slower=0.15,
    periodic=0.10,
    gap_spread=0.03,
    loose_start=True,
    creep=0.01,
    creep_s=15.0,
)
PROFILES = {profile.name: profile for profile in (SMOOTH, ROUGH)}
