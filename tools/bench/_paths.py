"""Makes the helpers of tests/epics, tests/host and tests/panel importable: the bench drives what the tests drive."""

import sys
from pathlib import Path

_TESTS = Path(__file__).resolve().parents[2] / "tests"
sys.path[:0] = [str(_TESTS / "beam"), str(_TESTS / "epics"), str(_TESTS / "host"), str(_TESTS / "panel")]
