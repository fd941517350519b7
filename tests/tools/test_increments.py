"""The screw of `hardware` sticks and slips as six real actuators do (docs/mechanics.md)."""

import increments
import numpy as np


def test_the_shares_of_stuck_and_double_increments_are_those_that_were_measured():
    pairs = [(real, increments.increments(real.step_urad)) for real in increments.MEASURED]
    off = np.array([(ours.stuck - real.stuck, ours.double - real.double) for real, ours in pairs])
    assert np.abs(off.mean(axis=0)).max() < 0.03
    assert np.sqrt((off**2).mean(axis=0)).max() < 0.10
    residuals = [ours.residual_urad / real.residual_urad for real, ours in pairs]
    assert 0.8 < np.mean(residuals) < 1.1


def test_a_screw_that_does_not_stick_is_never_stuck():
    assert increments.increments(1.25, 0.0).stuck < 0.01
