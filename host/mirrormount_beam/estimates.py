"""Measured values with their standard errors, and the results of experiments that hold them.

A standard error here is such that the truth lies within 2 of it in 95.4 % of all measurements, also for few samples:
the standard deviation of a mean of n samples is widened by Student's t. A Result has estimates, the readings behind
them, and remarks.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirrormount.markup import html_table, html_text

_ROUNDING = 1e-12  # relative error of a chain of floating-point operations
_TWO_SIDED = 2.0  # standard deviations that the quantile is taken at


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its standard error, both in `unit`; nan: not known. count: samples that it is made of."""

    value: float
    error: float
    unit: str
    count: int = 1

    def __str__(self) -> str:
        """Two digits of the error, and the value to the same place: "431.2 ± 1.3 urad".

        No error is shown where it is not known, or is that of the arithmetic.
        """
        if not math.isfinite(self.error) or self.error <= _ROUNDING * abs(self.value):
            return f"{self.value:.4g} {self.unit}".strip()
        digits = 1 - math.floor(math.log10(self.error))
        value, error = (round(number, digits) + 0.0 for number in (self.value, self.error))  # + 0.0: no "-0"
        shown = max(0, digits)
        return f"{value:.{shown}f} ± {error:.{shown}f} {self.unit}".strip()

    def scaled(self, factor: "float | Estimate", unit: str) -> "Estimate":
        """Times a factor, which may have an error of its own, in another unit."""
        other = factor if isinstance(factor, Estimate) else Estimate(factor, 0.0, "")
        error = math.hypot(self.error * other.value, self.value * other.error)
        return Estimate(self.value * other.value, error, unit, self.count)

    def over(self, other: "Estimate", unit: str = "") -> "Estimate":
        """The ratio of two independent estimates; other is not 0."""
        ratio = self.value / other.value
        error = math.hypot(self.error / other.value, ratio * other.error / other.value)
        return Estimate(ratio, error, unit, min(self.count, other.count))

    def minus(self, other: "Estimate") -> "Estimate":
        """The difference of two independent estimates of the same unit."""
        return Estimate(
            self.value - other.value, math.hypot(self.error, other.error), self.unit, min(self.count, other.count)
        )

    def to_json(self) -> dict[str, float | int | str | None]:
        """Value, standard error (None: not known), unit, count."""
        error = self.error if math.isfinite(self.error) else None
        return {"value": self.value, "standard_error": error, "unit": self.unit, "count": self.count}


def student(degrees: float) -> float:
    """By how much a standard deviation of few samples is widened: Student's quantile at 2 sigma, over 2.

    Expansion of the quantile in 1/degrees, Abramowitz and Stegun 26.7.5; within 1 % from 4 degrees on. Below 1 it is
    infinite: one sample says nothing of its scatter.
    """
    if degrees < 1:
        return math.inf
    z, v = _TWO_SIDED, degrees
    terms = (
        (z**3 + z) / (4 * v),
        (5 * z**5 + 16 * z**3 + 3 * z) / (96 * v**2),
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * v**3),
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / (92160 * v**4),
    )
    return (z + sum(terms)) / z


def mean(samples: Sequence[float] | NDArray[np.float64], unit: str) -> Estimate:
    """The mean of independent samples of one distribution; at least one."""
    values = np.asarray(samples, dtype=float)
    n = len(values)
    error = float(np.std(values, ddof=1)) / math.sqrt(n) * student(n - 1) if n > 1 else math.inf
    return Estimate(float(np.mean(values)), error, unit, n)


def spread(samples: Sequence[float] | NDArray[np.float64], unit: str) -> Estimate:
    """The standard deviation of samples of a normal distribution; at least two."""
    values = np.asarray(samples, dtype=float)
    n = len(values)
    deviation = float(np.std(values, ddof=1))
    return Estimate(deviation, deviation / math.sqrt(2 * (n - 1)) if n > 1 else math.inf, unit, n)


Tell = Callable[[float, str], object]  # progress: the part that is done (0 … 1), and the part that comes


# ---- results


@dataclass
class Series:
    """Readings for a curve: points (x, y, standard error of y), with their words and units.

    in_picture: x and y are those of the camera's picture: y down, both of one scale.
    """

    title: str
    x_label: str
    y_label: str
    points: list[tuple[float, float, float]] = field(default_factory=list)
    joined: bool = True
    in_picture: bool = False


@dataclass
class Result:
    """Of one experiment. readings: every observation, as rows of numbers under the names of columns.

    estimates: name → value. partial: why it ended early; "" if it did not. moves: False where nothing is moved, so that
    no estimate is an angle of the mirror.
    """

    experiment: str
    columns: tuple[str, ...] = ("t_s", "x_px", "y_px", "error_x_px", "error_y_px")
    readings: list[tuple[Any, ...]] = field(default_factory=list)
    estimates: dict[str, Estimate] = field(default_factory=dict)
    series: list[Series] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    partial: str = ""
    moves: bool = True

    def _repr_html_(self) -> str:
        early = f"<p><b>Ended early:</b> {html_text(self.partial)}</p>" if self.partial else ""
        rows = [(name, estimate, estimate.count) for name, estimate in self.estimates.items()]
        caption = f"measure {self.experiment}: {len(self.readings)} readings"
        told = "".join(f"<p>{html_text(remark)}</p>" for remark in self.remarks)
        return early + html_table(("", "measured", "of samples"), rows, caption) + told

    def to_json(self) -> dict[str, Any]:
        """All numbers with units and errors."""
        return {
            "experiment": self.experiment,
            "partial": self.partial,
            "estimates": {name: estimate.to_json() for name, estimate in self.estimates.items()},
            "remarks": self.remarks,
            "columns": list(self.columns),
            "readings": [list(row) for row in self.readings],
            "series": [
                {"title": s.title, "x": s.x_label, "y": s.y_label, "points": [list(p) for p in s.points]}
                for s in self.series
            ],
        }
