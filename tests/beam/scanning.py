"""What the tests of scans share."""

import csv


def rows_of(path):
    """The rows of a CSV file, and what its comments say."""
    lines = path.read_text("utf-8").splitlines()
    about = dict(text[2:].split(": ", 1) for text in lines if text.startswith("# "))
    return list(csv.DictReader(text for text in lines if not text.startswith("#"))), about
