"""Units in which a person gives an amount to move: steps, angles of the mirror or of the beam, mm on the screen.

The mirror's angle is measured (device/calibration.py). The beam's is that times beam_per_mirror; a spot on a screen
across the beam, at the distance L of the mirror, moves by L times the beam's angle, as long as that is small
(tan a = a within 0.3 % up to 100 mrad). Imports errors.
"""

from collections.abc import Callable, Mapping
from typing import Protocol

from mirrormount.common.errors import BadValue, NotCalibrated


class Geometry(Protocol):
    """Between mirror and screen; None: not known. device/calibration.py:Scale is one."""

    @property
    def beam_per_mirror(self) -> float | None:
        """By how much the beam turns when the mirror turns by 1."""
        ...

    @property
    def screen_mm(self) -> float | None:
        """From the mirror to the screen."""
        ...


STEPS = "steps"


def _mirror(_geometry: Geometry, mirror_mrad: float) -> float:
    return mirror_mrad


def _beam(geometry: Geometry, mirror_mrad: float) -> float | None:
    return mirror_mrad * geometry.beam_per_mirror if geometry.beam_per_mirror else None


def _screen(geometry: Geometry, mirror_mrad: float) -> float | None:
    beam_mrad = _beam(geometry, mirror_mrad)
    return beam_mrad * 1e-3 * geometry.screen_mm if beam_mrad and geometry.screen_mm else None


# of each unit: its amount for an angle of the mirror in mrad (None: not known), and how many of it that amount has
_OF: Mapping[str, tuple[Callable[[Geometry, float], float | None], float]] = {
    "mrad": (_mirror, 1.0),
    "urad": (_mirror, 1e3),
    "beam-mrad": (_beam, 1.0),
    "beam-urad": (_beam, 1e3),
    "mm": (_screen, 1.0),
}
UNITS = (STEPS, *_OF)
HELP = "steps (default); mrad, urad: of the mirror; beam-mrad, beam-urad; mm: on the screen"


def check(unit: str) -> str:
    """The unit, if it is one. Raises BadValue."""
    if unit not in UNITS:
        raise BadValue(f"a unit is {', '.join(UNITS[:-1])} or {UNITS[-1]}, not {unit!r}")
    return unit


def per_step(geometry: Geometry, mirror_mrad: float, unit: str, name: str) -> float:
    """How much of a unit one step is, if one step is mirror_mrad of the mirror. Raises NotCalibrated."""
    convert, of_unit = _OF[unit]
    amount = convert(geometry, mirror_mrad)
    if amount is None:
        missing = "beam_per_mirror" if not geometry.beam_per_mirror else "screen_mm"
        raise NotCalibrated(
            f"{name}: {unit} needs {missing} beside the scale: run `mirrormount setup` (docs/calibration.md)"
        )
    return amount * of_unit
