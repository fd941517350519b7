"""From numbers to a table: statistics, limits met or not, Markdown and JSON."""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass

import paper
from rows import Row

NO_GATE = "no gate in this firmware"
NOT_MODELLED = (
    "Emulated time. Not modelled: when a USB host polls and sends (full speed: up to 1 ms a turn; here a byte is the"
    " board's as soon as it asks for one), the second core."
)


@dataclass(frozen=True)
class Measurement:
    """What one row gave. Errors are judged by their size, so all but sd is of absolute values.

    No values: the row is about a gate that this firmware has not.
    """

    row: Row
    values: Sequence[float]
    wall_s: float = 0.0

    def _sorted(self) -> list[float]:
        """From the best to the worst."""
        return sorted((abs(v) for v in self.values), reverse=self.row.figure.more_is_better)

    @property
    def median(self) -> float:
        return statistics.median(self._sorted())

    @property
    def p99(self) -> float:
        """The value that 99 of 100 keep to: nearest rank."""
        return self._sorted()[math.ceil(0.99 * len(self.values)) - 1]

    @property
    def worst(self) -> float:
        return self._sorted()[-1]

    @property
    def sd(self) -> float | None:
        """Standard deviation of the values with their signs; None for fewer than two, or if one was lost."""
        if len(self.values) < 2 or not all(map(math.isfinite, self.values)):
            return None
        return statistics.stdev(self.values)

    @property
    def judged(self) -> float:
        """The value that the limits are for."""
        return self.p99 if self.row.figure.p99 else self.worst

    def meets(self, limit: float | None) -> bool | None:
        """Whether the judged value keeps a limit; None without one, or without values."""
        if limit is None or not self.values:
            return None
        return self.judged >= limit if self.row.figure.more_is_better else self.judged <= limit

    def missed(self, *, quick: bool) -> str:
        """The row and its limit, if a check fails; else "". quick: a row with a floor has to keep that instead."""
        must, floor = self.row.figure.must, self.row.floor
        if self.meets(must) is not False or (quick and self.meets(floor)):
            return ""
        limit = f"must {must:g}" if floor is None or not quick else f"must {must:g}, floor {floor:g}"
        return f"{self.row.name}: {_text(self.judged)} {self.row.figure.unit}, {limit}"


def markdown(measurements: Sequence[Measurement]) -> str:
    """The table, and what it does not tell."""
    lines = [
        "| | unit | n | median | p99 | worst | sd | must | aim | the paper's sketch |",
        "|---|---|--:|--:|--:|--:|--:|---|---|---|",
    ]
    for m in measurements:
        if not m.values:
            lines.append(f"| {m.row.what} | {m.row.figure.unit} | {NO_GATE} |  |  |  |  | {_plain(m)} |")
            continue
        numbers = [_text(v) for v in (m.median, m.p99, m.worst, m.sd)]
        limits = [_limit(m, limit) for limit in (m.row.figure.must, m.row.figure.aim)]
        cells = [m.row.what, m.row.figure.unit, str(len(m.values)), *numbers, *limits, m.row.paper]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", NOT_MODELLED, "", f"The paper's sketch: {paper.SOURCE}."])


def _plain(m: Measurement) -> str:
    limits = ["" if limit is None else f"{limit:g}" for limit in (m.row.figure.must, m.row.figure.aim)]
    return " | ".join([*limits, m.row.paper])


def _limit(m: Measurement, limit: float | None) -> str:
    if limit is None:
        return ""
    return f"{limit:g}: {'met' if m.meets(limit) else '**not met**'}"


def _text(value: float | None) -> str:
    if value is None:
        return ""
    if math.isinf(value):
        return "lost"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def as_json(measurements: Sequence[Measurement]) -> list[dict]:
    """The same for programs, with every value; what was lost is null."""
    return [
        {
            "name": m.row.name,
            "what": m.row.what,
            "unit": m.row.figure.unit,
            "n": len(m.values),
            "median": _number(m.median) if m.values else None,
            "p99": _number(m.p99) if m.values else None,
            "worst": _number(m.worst) if m.values else None,
            "sd": m.sd,
            "judged_by": "p99" if m.row.figure.p99 else "worst",
            "must": m.row.figure.must,
            "must_met": m.meets(m.row.figure.must),
            "aim": m.row.figure.aim,
            "aim_met": m.meets(m.row.figure.aim),
            "paper": m.row.paper,
            "wall_s": round(m.wall_s, 1),
            "values": [_number(v) for v in m.values],
        }
        for m in measurements
    ]


def _number(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None
