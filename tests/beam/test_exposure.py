"""Advice on the exposure, and cuts along the axes of a beam."""

import cv2
import numpy as np
import pytest

from mirrormount_beam import find_spot
from mirrormount_beam.camera import Image, Limits, Picture, checked
from mirrormount_beam.cuts import cuts
from mirrormount_beam.exposure import AIM, advice

ROWS, COLUMNS = np.mgrid[:240, :320].astype(float)


def beam(peak, wide=12.0, high=12.0, angle=0.0, dark=10.0):
    """A noisy picture of one beam, before it is cut to the range."""
    turned, x, y = np.radians(angle), COLUMNS - 150.4, ROWS - 118.7
    u, v = x * np.cos(turned) + y * np.sin(turned), y * np.cos(turned) - x * np.sin(turned)
    light = peak * np.exp(-((u / wide) ** 2 + (v / high) ** 2) / 2)
    return dark + light + np.random.default_rng(3).normal(size=light.shape) * np.sqrt(1 + light / 50)


def cut_off(light, end=255, kind=np.uint8):
    return np.clip(np.rint(light), 0, end).astype(kind)


@pytest.mark.parametrize(
    ("peak", "kind", "words"),
    [
        (30, "dark", "too dark, 1"),
        (140, "right", "right, "),
        (210, "bright", "nearly saturated, 8"),
        (380, "saturated", "saturated, about 1.5 times the range: exposure times 0.39 (-1.4 in powers of 2)"),
        (1000, "saturated", "saturated, about "),
    ],
)
def test_the_advice_brings_the_peak_to_three_fifths_of_the_range(peak, kind, words):
    frame = Image(cut_off(beam(peak)), 0.0, 0)
    told = advice(frame, find_spot(frame))
    assert told.kind == kind and told.words.startswith(words)
    factor = told.factor or 1.0
    assert (10 + peak) * factor / 255 == pytest.approx(AIM, rel=0.15)


def test_the_range_of_12_bits_is_that_of_12_bits():
    frame = Image(cut_off(beam(6000, dark=100), 4095, np.uint16), 0.0, 0)
    assert advice(frame, find_spot(frame)).factor == pytest.approx(AIM * 4095 / 6100, rel=0.1)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (cut_off(beam(0)), "too dark, 4% of 255, if the beam is on: exposure times 10 or more"),
        (np.full((240, 320), 255, np.uint8), "saturated, 10 times the range or more: exposure times 0.1 or less"),
        (np.zeros((240, 320), np.uint8), "too dark, 0% of 255, if the beam is on"),
        (cut_off(60000 * np.exp(-((COLUMNS - 160) ** 2 + (ROWS - 120) ** 2) / 1000)), "saturated, 10 times"),
    ],
)
def test_a_picture_without_a_spot_is_told_too_dark_or_too_bright(image, words):
    frame = Image(image, 0.0, 0)
    found = find_spot(frame)
    assert not found and advice(frame, found).words.startswith(words)


def test_nothing_is_advised_where_the_light_does_not_tell_it():
    two = Image(cut_off(np.maximum(beam(150), np.roll(beam(150), 110, axis=1))), 0.0, 0)
    assert advice(two, find_spot(two)) is None


def test_one_saturated_channel_is_named():
    image = np.dstack([cut_off(beam(peak)) for peak in (700, 20, 150)])
    (frame,) = checked(iter([Picture(image, 0.0)]), "cam", None, Limits())
    told = advice(frame, find_spot(frame))
    assert (told.kind, told.factor) == ("right", None)
    assert told.words.startswith("red is right, ") and told.words.endswith("; blue is saturated")


def test_cuts_are_along_the_axes_and_a_gaussian_beam_is_its_own_gaussian():
    image = cut_off(beam(180, 20, 10, angle=25))
    longer, shorter = cuts(image, find_spot(image))
    assert (longer.angle, shorter.angle) == (pytest.approx(25, abs=1), pytest.approx(-65, abs=1))
    assert (longer.sigma, shorter.sigma) == (pytest.approx(20, rel=0.03), pytest.approx(10, rel=0.03))
    for cut in (longer, shorter):
        assert np.abs(cut.light - cut.gaussian).max() < 8  # of 180; the noise is 2
        assert cut.light[np.abs(cut.at).argmin()] == pytest.approx(190, abs=6)


def test_a_flat_top_is_seen_beside_the_gaussian_of_its_size():
    light = 10 + 150 * (np.hypot(COLUMNS - 150, ROWS - 120) < 25).astype(float)
    image = cut_off(cv2.GaussianBlur(light, (0, 0), 3) + np.random.default_rng(1).normal(size=light.shape))
    cut, _ = cuts(image, find_spot(image))
    assert cut.gaussian.max() - cut.light.max() > 20


def test_a_cut_ends_at_the_edge_of_the_picture():
    image = cut_off(beam(150))[85:]
    longer, shorter = cuts(image, find_spot(image))
    assert min(len(longer.at), len(shorter.at)) < 91 and np.isfinite([*longer.light, *shorter.light]).all()
