"""The bill of materials of one motorised mount, bill.csv, and its totals. Prices are about, in USD."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

FILE = Path(__file__).resolve().parent / "bill.csv"
HEAD = ["group", "part", "count", "usd_each", "usd", "source"]
TOTALS = {
    "total without the mount": ("drive", "electronics"),
    "total with the mount": ("mount", "drive", "electronics"),
    "total with switches and encoders": ("mount", "drive", "electronics", "switches", "encoders"),
}


def rows() -> list[dict[str, str]]:
    """Every part, with what all of its pieces cost."""
    with FILE.open(encoding="utf-8", newline="") as file:
        read = list(csv.DictReader(file))
    return [row | {"usd": f"{int(row['count']) * float(row['usd_each']):.2f}"} for row in read]


def totals() -> dict[str, float]:
    """The sums by TOTALS, in USD."""
    return {
        words: round(sum(float(row["usd"]) for row in rows() if row["group"] in groups), 2)
        for words, groups in TOTALS.items()
    }


def write(path: Path) -> None:
    """The bill with its totals as CSV."""
    with path.open("w", encoding="utf-8", newline="") as file:
        out = csv.DictWriter(file, HEAD, lineterminator="\n")
        out.writeheader()
        out.writerows(rows())
        out.writerows({"part": words, "usd": f"{total:.2f}", "source": "sum"} for words, total in totals().items())


def table() -> Iterator[tuple[str, ...]]:
    """The bill with its totals as the rows of a table."""
    yield "for", "part", "pieces", "about, USD", "source"
    for row in rows():
        yield row["group"], row["part"], row["count"], row["usd"], row["source"]
    for words, total in totals().items():
        yield "", f"**{words}**", "", f"**{round(total)}**", "sum"
