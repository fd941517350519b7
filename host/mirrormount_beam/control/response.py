"""What a step or a pulse of each actuator does to the spots: matrix for both directions, pulse curve, gaps, errors.

Units: um of the spots in their planes (x and y, up, of each camera in turn) for a step; microseconds; parts of a step.
Each correction refines it: the rank-one update of C. G. Broyden, Math. Comp. 19 (1965) 577, damped, for a correction
measures the matrix along one direction only, and with noise.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirrormount import files
from mirrormount.errors import BadFile
from mirrormount_beam.control.backlash import Width
from mirrormount_beam.control.interfaces import LoopTable
from mirrormount_beam.errors import ResponseOfOther
from mirrormount_beam.runlog import Rms

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
WAYS = (1, -1)
_FORMAT = 2
_DAMPING = 0.3  # of an update of the matrix
SHORTEST_US = 5000  # A shorter pulse does not always move a rough motor.
_SHORT_DAMPING = 0.05  # of the factor of short pulses, which scatter
_MOST_SHORT = 3.0  # of that factor, either way


@dataclass(frozen=True, slots=True)
class Travel:
    """A way of a shaft: |whole| steps and a pulse of us (0: none). steps: what is expected, ± scatter."""

    way: int
    whole: int
    us: int
    steps: float
    scatter: float


@dataclass(frozen=True)
class Curve:
    """How far a pulse moves the screw: lengths in us, rising, and steps; the last one is a step.

    scatter: standard deviation of one pulse's way, in steps. It does not go to 0 with the length: the tip of a screw
    sticks and slips. errors: standard errors of steps.
    """

    us: tuple[float, ...]
    steps: tuple[float, ...]
    scatter: tuple[float, ...]
    errors: tuple[float, ...] = ()

    def steps_of(self, us: float) -> float:
        """The way of a pulse up to a step's length, between the measured ones by a power law."""
        return math.exp(_line(math.log(us), np.log(self.us), np.log(self.steps)))

    def us_of(self, steps: float) -> float:
        """The length of a pulse for a part of a step."""
        return math.exp(_line(math.log(steps), np.log(self.steps), np.log(self.us)))

    def scatter_of(self, us: float) -> float:
        """The standard deviation of the way of a pulse up to a step's length, in steps."""
        return float(np.interp(math.log(us), np.log(self.us), self.scatter))


@dataclass
class Response:
    """A calibration. matrices: for the ways 1 and -1, (2 · cameras, actuators), um for a step.

    matrix_errors: standard errors of them, alike. widths_: for each actuator and way. short: for each actuator and
    way, what a pulse shorter than a step makes of the curve's way. noise_um: covariance of one image's errors (um²).
    drift_um2_s: by which their covariance grows in a second at rest. promise: what the table will hold by all this.
    belongs: what it is of. measured: date and time.
    """

    matrices: dict[int, Matrix]
    matrix_errors: dict[int, Matrix]
    curve: Curve
    widths: list[dict[int, Width]]
    noise_um: Matrix
    drift_um2_s: Matrix
    belongs: dict[str, Any]
    measured: str = ""
    promise: Rms | None = None
    short: list[dict[int, float]] = field(default_factory=list)
    start: dict[int, Matrix] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.short = self.short or [{1: 1.0, -1: 1.0} for _ in self.widths]
        self.start = self.start or {way: matrix.copy() for way, matrix in self.matrices.items()}

    @property
    def actuators(self) -> int:
        """How many."""
        return len(self.widths)

    def column(self, actuator: int, way: int) -> Vector:
        """um for a step of the shaft in that way, per step in that way's sign: errors change by column · steps."""
        return self.matrices[way][:, actuator]

    def columns(self, steps: Vector) -> Matrix:
        """The matrix for steps of these signs; 0 counts as positive."""
        return np.where(np.asarray(steps) < 0, self.matrices[-1], self.matrices[1])

    def effect(self, steps: Vector) -> Vector:
        """The change of all errors by steps of the screws, um."""
        return self.columns(steps) @ steps

    def travel(self, actuator: int, steps: float) -> Travel:
        """How to turn a shaft by steps (signed). A way of less than the shortest pulse's is made that long."""
        way = 1 if steps > 0 else -1
        whole = int(abs(steps))
        us = self._pulse_us(actuator, way, abs(steps) - whole)
        if whole and us <= SHORTEST_US:
            us = 0
        part = self._pulse_steps(actuator, way, us) if us else 0.0
        short = self.curve.scatter_of(us) if us else 0.0
        return Travel(way, whole, us, whole + part, math.hypot(math.sqrt(whole) * self.curve.scatter[-1], short))

    @property
    def change(self) -> float:
        """The largest relative change of a column since the calibration."""
        parts = [
            np.linalg.norm(self.matrices[way] - self.start[way], axis=0) / np.linalg.norm(self.start[way], axis=0)
            for way in WAYS
        ]
        return float(np.max(parts))

    def refine(self, steps: Vector, changed_um: Vector, noise_um: float) -> None:
        """A correction by these steps of the screws changed the errors so (± noise_um each)."""
        expected = self.effect(steps)
        weights = np.minimum(np.abs(steps), 1.0)  # short pulses scatter: they say little of the matrix
        inner = float(weights @ np.abs(steps))
        size = float(expected @ expected)
        if not inner or not size:
            return
        trust = _DAMPING * size / (size + noise_um**2 * len(changed_um) * 4)
        update = trust * np.outer(changed_um - expected, weights * np.sign(steps)) / inner
        for actuator in np.flatnonzero(steps):
            self.matrices[1 if steps[actuator] > 0 else -1][:, actuator] += update[:, actuator] * min(1.0, inner)

    def _pulse_us(self, actuator: int, way: int, steps: float) -> int:
        """The length of the pulse for a part of a step (0 … 1): 0, or at least the shortest one."""
        if not steps:
            return 0
        wanted = min(steps / self._factor(actuator, way, steps), 1.0)
        return round(max(self.curve.us_of(max(wanted, 1e-6)), SHORTEST_US))

    def _pulse_steps(self, actuator: int, way: int, us: int) -> float:
        """The way of a pulse up to a step's length."""
        plain = self.curve.steps_of(us)
        return plain * self._factor(actuator, way, plain)

    def refine_short(self, actuator: int, way: int, ratio: float, weight: float) -> None:
        """A short pulse went `ratio` times as far as expected; weight (0 … 1): how well that is known."""
        bounded = min(max(ratio, 0.3), 2.0)
        factor = self.short[actuator][way] * bounded ** (_SHORT_DAMPING * weight)
        self.short[actuator][way] = min(max(factor, 1 / _MOST_SHORT), _MOST_SHORT)

    def _factor(self, actuator: int, way: int, steps: float) -> float:
        """The factor of short pulses fades towards a whole step, by which the matrix is measured."""
        return self.short[actuator][way] ** (1 - min(steps, 1.0))

    # ---- on disk

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "format": _FORMAT,
            "measured": self.measured,
            "belongs": self.belongs,
            "um_for_a_step": _by_way(self.matrices),
            "um_for_a_step_error": _by_way(self.matrix_errors),
            "um_for_a_step_at_calibration": _by_way(self.start),
            "curve": {
                "us": list(self.curve.us),
                "steps": list(self.curve.steps),
                "scatter_steps": list(self.curve.scatter),
                "error_steps": list(self.curve.errors),
            },
            "short_pulses": [{str(way): value for way, value in each.items()} for each in self.short],
            "gap_steps": [{str(way): [w.mean, w.spread, w.samples] for way, w in each.items()} for each in self.widths],
            "noise_um2": self.noise_um.tolist(),
            "drift_um2_s": self.drift_um2_s.tolist(),
            "promise": self.promise and asdict(self.promise),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "Response":
        """What to_json() made. Raises KeyError, TypeError or ValueError if it is none."""
        if data["format"] != _FORMAT:
            raise ValueError(f"format {data['format']}, not {_FORMAT}: measure it anew")
        curve = data["curve"]
        response = cls(
            matrices=_ways(data["um_for_a_step"]),
            matrix_errors=_ways(data["um_for_a_step_error"]),
            curve=Curve(*(tuple(curve[name]) for name in ("us", "steps", "scatter_steps", "error_steps"))),
            widths=[{int(way): Width(*w) for way, w in each.items()} for each in data["gap_steps"]],
            noise_um=np.array(data["noise_um2"], dtype=float),
            drift_um2_s=np.array(data["drift_um2_s"], dtype=float),
            promise=data["promise"] and Rms(**data["promise"]),
            belongs=data["belongs"],
            measured=data["measured"],
            short=[{int(way): float(value) for way, value in each.items()} for each in data["short_pulses"]],
            start=_ways(data["um_for_a_step_at_calibration"]),
        )
        shape = 2 * len(data["belongs"]["cameras"]), len(response.widths)
        if any(m.shape != shape or not np.isfinite(m).all() for m in response.matrices.values()):
            raise ValueError("the matrix has another size, or holes")
        return response


def belongs_to(table: LoopTable) -> dict[str, Any]:
    """What a calibration is of: boards and steps, cameras with sizes and scales."""
    return {
        "actuators": [[a.name, a.board_id, a.step_us] for a in table.actuators],
        "cameras": [[camera.name, *camera.size, *camera.um_per_px] for camera in table.cameras],
    }


def check_belongs(response: Response, table: LoopTable) -> None:
    """Raises ResponseOfOther if a step, a camera or a board has changed since."""
    now = belongs_to(table)
    for what, words in (("actuators", "mounts (name, board, step in us)"), ("cameras", "cameras (name, size, scale)")):
        then = response.belongs[what]
        if then != now[what]:
            raise ResponseOfOther(f"the calibration of {response.measured} is of the {words} {then}, now: {now[what]}")


def save(response: Response, path: Path) -> None:
    """Write it, complete or not at all. Raises CannotWrite."""
    files.write_atomic(files.behind_link(path), json.dumps(response.to_json(), indent=1) + "\n", make_folder=True)


def check_place(path: Path) -> None:
    """Raises CannotWrite if save() would: for a caller that has not measured yet."""
    files.check_writable(files.behind_link(path), make_folder=True)


def load(path: Path, table: LoopTable) -> Response | None:
    """The calibration in a file, None if there is no file. Raises BadFile, ResponseOfOther."""
    try:
        response = Response.from_json(files.read_json(path))
    except FileNotFoundError:
        return None
    except OSError as e:
        raise BadFile(f"{path}: {e.strerror or e}") from e
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as e:
        raise BadFile(f"{path} is no calibration of a table ({type(e).__name__}: {e})") from e
    check_belongs(response, table)
    return response


def _line(x: float, xs: Vector, ys: Vector) -> float:
    """Linear interpolation, and beyond the ends along the last two points."""
    if x < xs[0]:
        return float(ys[0] + (x - xs[0]) * (ys[1] - ys[0]) / (xs[1] - xs[0]))
    return float(np.interp(x, xs, ys))


def _by_way(matrices: Mapping[int, Matrix]) -> dict[str, Any]:
    return {str(way): matrix.tolist() for way, matrix in matrices.items()}


def _ways(data: Mapping[str, Sequence[Sequence[float]]]) -> dict[int, Matrix]:
    return {int(way): np.array(rows, dtype=float) for way, rows in data.items()}
