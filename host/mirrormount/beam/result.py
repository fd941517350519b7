"""What an experiment returns: estimates, the readings behind them, remarks. Imports estimate."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from mirrormount.beam.estimate import Estimate

Tell = Callable[[float, str], object]  # progress: the part that is done (0 … 1), and the part that comes


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
    """Of one experiment. readings: every look, as rows of numbers under the names of columns.

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
