"""What a virtual mount is made of: every constant of the mechanics, with its source, or "estimate" and its range.

`smooth` is kind and gives the paper's figures; `rough` is a mount of hobby parts, all of whose numbers are assumed.
`hardware` is what data sheets, and measurements that others made on real actuators, say. mechanics.py has the
equations. docs/mechanics.md shows the effects of `hardware` and has this table, which tools/tables.py writes.

Kies: L. Kies, Leibniz University Hannover, github.com/lkies/motorized-mounts, which measured six actuators on kinematic
mirror mounts, two of them Newport's. Pololu: the data sheet of the micro metal gearmotors, May 2018, 1000:1 LP 6 V: 13
turns a minute and 20 mA unloaded, 0.36 A stalled.
"""

from dataclasses import dataclass, field, fields
from typing import Any

# The same for all profiles, and not in the paper.
PITCH_MM = 25.4 / 80  # of a fine adjustment screw: 80 threads an inch. Estimate: 80 to 100
GAP_REV = 0.03481  # play between shaft and screw: fitted, with the levers of bench.py, to the paper's step and backlash
GEAR_SHARE = 0.4  # of that gap is in the gears, 5 degrees; the rest is in the coupler. Estimate: 0.2 to 0.7
TRAVEL_REV = 12.0  # hard ends of the screw either way. Estimate: 10 to 20
SWITCH_REV = 1.5  # where the optional switches sit, either way; about 64 steps
GEARS = 986.41  # of the paper's motor, Pololu #1595
DETENTS_REV = 6 * GEARS  # a rotor with three slots between two poles has six detents a turn

# What brushes do to a USB cable when a motor starts (option emi=1). All are estimates: that ports are lost is known
# (MicroPython issue 8573, tinyusb issue 3098), how often depends on the wires and on capacitors at the motors.
EMI_S = 0.005  # after a start the wire is disturbed. Range: 0.001 to 0.05
EMI_LOST = 0.05  # of the bytes meanwhile do not come. Range: 0 to 0.5
EMI_GONE = 0.01  # of the starts make the port go ... Range: 0 to 0.1
EMI_GONE_S = 2.0  # ... and come back after this time. Range: 1 to 5
DAY_S = 86_400.0  # of the room's temperature

_MOTOR_OHM = 6.0 / 0.36  # Pololu: 6 V, 0.36 A stalled
_BRUSHES_V = 0.02 * _MOTOR_OHM  # the voltage that drives the current of the unloaded motor, Pololu's 20 mA
_SCREW_V = 0.16  # the same for the screw's friction. Estimate: 0.05 to 0.5 (14 N mm of 0.53 N m at stall)
_VOLTS = 3.2  # what an SN754410 leaves of 5 V. Estimate: 2.8 to 3.6 (its data sheet: 2.2 to 2.6 V lost at 0.5 A)
_REV_S_VOLT = 13 / 60 / (6.0 - _BRUSHES_V)  # Pololu: 13 turns a minute at 6 V


def _fact(default: float, what: str, source: str = "estimate") -> Any:
    """A number of a profile: what it is, and where that of `hardware` is from."""
    return field(default=default, metadata={"what": what, "source": source})


@dataclass(frozen=True)
class Profile:
    """What differs between kind and real mechanics. Shares are of 1; 0 means that there is no such effect."""

    name: str
    speed_rev_s: float = _fact(
        0.125, "turns of the gearbox's shaft in a second, at full duty", "Pololu, at what the bridge leaves of 5 V"
    )
    pulse_noise: float = _fact(
        0.005, "spread of the speed from pulse to pulse, one standard deviation", "estimate: 0.01 to 0.05"
    )
    short_noise: float = _fact(0.0, "further spread of a pulse of length 0 …", "the friction's spread takes its place")
    short_s: float = _fact(0.02, "… which fades with the pulse's length T as exp(−T / this), s", "–")
    breakaway_s: float = _fact(
        0.0, "from the begin of a drive at rest to the first motion, s: mean …", "spin-up and detents take its place"
    )
    breakaway_spread_s: float = _fact(0.0, "… and standard deviation", "–")
    negative_slower: float = _fact(
        0.0, "by how much the negative direction is slower", "estimate: 0 to 0.15 (brushes are not quite neutral)"
    )
    spin_up_s: float = _fact(
        0.02,
        "time constant of the motor at full duty, s",
        "estimate: 0.01 to 0.02 (rotor of 0.11 g cm²)",
    )
    volts: float = _fact(_VOLTS, "at the motor with the nominal supply, V", "estimate: 2.8 to 3.6 (SN754410 at 5 V)")
    friction_v: float = _fact(
        0.0,
        "voltage that overcomes the friction of motor and screw, V",
        "Pololu: 20 mA of 0.36 A; the screw's: estimate, 0.05 to 0.5",
    )
    friction_spread: float = _fact(0.0, "spread of that friction from pulse to pulse", "estimate: 0.1 to 0.3")
    cogging_v: float = _fact(
        0.0,
        "further voltage that lifts the rotor out of a detent, V",
        "estimate: 0.3 to 1.5 (such motors start at 25 to 30 % duty, some not below 2 V: Adafruit, Arduino forum)",
    )
    electrical_s: float = _fact(
        0.0, "inductance over resistance of the motor, s; 0: torque is proportional to duty", "estimate: 0.1 to 0.3 ms"
    )
    sag: float = _fact(
        0.0,
        "share of the voltage that one stalled motor takes from another",
        "estimate: 0.02 to 0.1 (0.2 A, 0.5 ohm)",
    )
    coast_s: float = _fact(0.02, "time constant of viscous friction without drive, s", "estimate: 0.3 and more")
    coast_rev_s2: float = _fact(
        5.0,
        "deceleration without drive by what is not in the friction's voltage, turns/s²",
        "the friction's voltage says all",
    )
    gap_spread: float = _fact(
        0.0, "spread of the gap from reversal to reversal, of its width", "Kies: 3 to 7 µrad of the mirror, here 10"
    )
    gap_wave: float = _fact(
        0.0, "amplitude of the gap over a turn of the screw, of its width", "Kies: varies by 2 to 18 % with the place"
    )
    loose_start: bool = _fact(False, "the shaft starts anywhere in the gap", "–")
    stick_um: float = _fact(
        0.0,
        "mean lag of the screw's tip at which it slips, µm of its travel; uniform from 0 to twice this",
        "Kies: 0.09 to 0.16, 0.13 fits all six together best",
    )
    periodic: float = _fact(0.0, "amplitude of the mirror's speed over a turn of the screw", "estimate: 0.03 to 0.1")
    creep: float = _fact(0.0, "share of a motion that comes later …", "estimate: 0 to 0.05")
    creep_s: float = _fact(1.0, "… with this time constant, s", "estimate: 5 to 60")
    cross: float = _fact(
        0.0,
        "share of each axis' angle that the other axis of its mount gets",
        "estimate: 0 to 0.05 (screws off the pivots' lines)",
    )
    twist_urad: float = _fact(
        0.0, "by which the motors' plate twists the mirror while a motor drives, µrad", "estimate: 0 to 100"
    )
    day_urad: float = _fact(
        0.0,
        "amplitude of each mirror's drift with the room's temperature over a day, µrad",
        "estimate: 5 to 50 (2 K, 2 to 20 µrad/K)",
    )
    supply: float = _fact(1.0, "the motors' voltage, of the nominal one", "–")


SMOOTH = Profile("smooth")
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
HARDWARE = Profile(
    "hardware",
    speed_rev_s=(_VOLTS - _BRUSHES_V - _SCREW_V) * _REV_S_VOLT,
    pulse_noise=0.02,
    negative_slower=0.05,
    spin_up_s=0.015,
    friction_v=_BRUSHES_V + _SCREW_V,
    friction_spread=0.2,
    cogging_v=0.6,
    electrical_s=1.5e-4,
    sag=0.05,
    coast_s=1.0,
    coast_rev_s2=0.0,
    gap_spread=0.03,
    gap_wave=0.05,
    loose_start=True,
    stick_um=0.13,
    periodic=0.10,
    creep=0.01,
    creep_s=15.0,
    cross=0.02,
    twist_urad=20.0,
    day_urad=20.0,
)
PROFILES = {profile.name: profile for profile in (SMOOTH, ROUGH, HARDWARE)}


def facts() -> list[tuple[str, str, str]]:
    """For each number of a profile: its name, what it is, and where that of `hardware` is from."""
    return [(each.name, each.metadata["what"], each.metadata["source"]) for each in fields(Profile) if each.metadata]
