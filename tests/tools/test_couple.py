"""Facts about tools/bench/couple.py: its simplex and its raster find a maximum where a step is a step."""

import couple
import numpy as np
import pytest


class Exact:
    """Axes without a gap: a Gaussian of the counted position, as wide as the virtual fibre is for the motors."""

    def __init__(self, axes: int) -> None:
        self.top, self.at = np.full(axes, 0.6), np.zeros(axes)

    def go(self, steps: np.ndarray) -> float:
        self.at = steps.copy()
        return self.light()

    def light(self) -> float:
        return float(np.exp(-np.sum(((self.at - self.top) / 0.55) ** 2)))


@pytest.mark.parametrize("method", [couple.simplex, couple.raster])
def test_without_a_gap_the_others_couple_two_axes(method):
    stepper = Exact(2)
    method(stepper, 2)
    assert stepper.light() > 0.95
