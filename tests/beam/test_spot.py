"""find_spot on pictures of which the true place of the spot is known."""

import cv2
import numpy as np
import pytest
import scenes

from mirrormount.errors import BadValue
from mirrormount_beam.camera import Dark
from mirrormount_beam.spot.find import NoSpotReason, find_spot


def rng(seed):
    return np.random.default_rng(seed)


def spot_scene(seed=1, *, peak=150.0, width=10.0, x=300.3, y=200.7):
    return 8 + peak * scenes.gaussian(x, y, width, width), rng(seed)


def test_a_clean_spot_is_found_to_two_hundredths_of_a_pixel():
    found = [(scene, find_spot(scene.image)) for scene in (scenes.clean(rng(seed)) for seed in range(25))]
    assert all(spot for _, spot in found)
    errors = np.array([(spot.x - scene.truth[0], spot.y - scene.truth[1]) for scene, spot in found])
    assert np.sqrt((errors**2).mean()) < 0.02
    assert np.sqrt((errors**2).mean()) < 1.4 * np.mean([spot.sigma_x for _, spot in found])


def test_each_answer_in_nasty_scenes_is_within_its_error_or_a_refusal():
    judge(range(200))


@pytest.mark.full
def test_of_ten_thousand_nasty_scenes_one_in_a_hundred_has_a_wrong_answer():
    pulls = judge(range(10_000), most_wrong=0.01)
    assert 0.89 <= (np.abs(pulls) < 2).mean() <= 0.98


@pytest.mark.parametrize("width", [6.0, 12.0])
@pytest.mark.parametrize("peak", [1000.0, 2000.0, 6000.0, 20_000.0])
def test_a_spot_that_is_mostly_saturated_is_refused_for_that(width, peak):
    y, x = np.mgrid[:480, :640]
    light = 6 + peak * np.exp(-((x - 320) ** 2 + (y - 240) ** 2) / (2 * width**2)) + rng(1).normal(0, 1, (480, 640))
    found = find_spot(np.clip(light, 0, 255).astype(np.uint8))
    assert not found
    assert found.reason is NoSpotReason.SATURATED


def test_two_spots_with_a_valley_between_them_are_refused():
    for apart, ratio in ((34.0, 1.0), (40.0, 0.5), (60.0, 0.3), (150.0, 0.4)):
        light = 8 + 150 * (
            scenes.gaussian(300.3, 200.7, 10, 10) + ratio * scenes.gaussian(300.3 + apart, 200.7, 10, 10)
        )
        found = find_spot(scenes.expose(light, rng(1)))
        assert not found, (apart, ratio)
        assert found.reason is NoSpotReason.SPLIT


# Beams that are no Gaussian. The third Hermite mode leaves the centroid where it is, and moves the brightest point.


def hermite(x, y, wide, high, *, skew=0.0, flat=0.0, angle=0.0, shape=(480, 640)):
    v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
    dx, dy, cos, sin = u - x, v - y, np.cos(angle), np.sin(angle)
    a, b = (dx * cos + dy * sin) / wide, (dy * cos - dx * sin) / high
    more = skew * (a**3 - 3 * a) - flat * (a**4 - 6 * a * a + b**4 - 6 * b * b + 6)
    return np.exp(-(a * a + b * b) / 2) * np.clip(1 + more, 0, None)


@pytest.mark.parametrize(("sigma", "skew"), [(11, 0.05), (16, 0.04), (24, 0.05)])
def test_the_place_of_a_skewed_beam_is_between_its_brightest_point_and_its_centroid(sigma, skew):
    light = 180 * hermite(311.4, 230.8, sigma, sigma, skew=skew)
    found = find_spot(scenes.expose(8 + light, rng(3)))
    brightest = np.unravel_index(light.argmax(), light.shape)[1]
    assert brightest - 0.1 < found.x < 311.4 + 0.1
    assert abs(found.y - 230.8) < 5 * found.sigma_y
    assert found.shape_px > 5 * found.sigma_x


@pytest.mark.parametrize("sigma", [14, 25])
def test_a_skewed_beam_at_rest_scatters_as_is_stated_and_does_not_jump(sigma):
    light = 8 + 170 * hermite(290.7, 250.2, sigma, 1.2 * sigma, skew=0.02, flat=0.005)
    found = [find_spot(scenes.expose(light, rng(seed))) for seed in range(60)]
    assert all(found)
    x = np.array([spot.x for spot in found])
    stated = np.median([spot.sigma_x for spot in found])
    assert 0.6 < x.std() / stated < 1.3
    assert np.abs(x - x.mean()).max() < 4.5 * stated


@pytest.mark.parametrize("ratio", [1.0, 1.25, 1.5])
@pytest.mark.parametrize(("skew", "flat"), [(0.02, 0.005), (0.045, 0.01)])
def test_an_elliptical_beam_that_is_no_gaussian_is_one_beam_at_its_centroid(ratio, skew, flat):
    light = 190 * hermite(330.6, 220.3, 13 * ratio, 13, skew=skew, flat=flat, angle=0.5)
    found = find_spot(scenes.expose(10 + light, rng(2)))
    assert abs(found.x - 330.6) < 0.3 and abs(found.y - 220.3) < 0.3
    assert found.ellipticity == pytest.approx(1 / ratio, abs=0.08)
    if ratio > 1:
        assert found.angle == pytest.approx(np.degrees(0.5), abs=6)


@pytest.mark.parametrize("sigma", [1.5, 3, 28, 45, 90, 150, 190])
def test_a_beam_of_any_width_is_found(sigma):
    light = 170 * hermite(620.4, 470.7, sigma, sigma, shape=(960, 1280))
    noise = rng(4).normal(size=light.shape) * np.sqrt(1 + 0.1 * light)
    found = find_spot(np.clip(np.rint(light + 9 + noise), 0, 255).astype(np.uint8))
    pull = (found.x - 620.4) / found.sigma_x, (found.y - 470.7) / found.sigma_y
    assert max(map(abs, pull)) < 5
    assert found.sigma_x < 0.02 + (0.005 if sigma < 150 else 0.015) * sigma
    if sigma < 100:
        assert found.d4_long == pytest.approx(4 * sigma, rel=0.05)


@pytest.mark.parametrize("factor", [0.93, 0.8, 0.65])
def test_rows_of_alternating_brightness_move_nothing_and_are_in_no_error(factor):
    pulls = []
    for seed in range(60):
        x, y = 310 + rng(seed).random(2)
        light = 170 * scenes.gaussian(x, y, 11, 11)
        light[1::2] *= factor
        found = find_spot(scenes.expose(light + 8, rng(seed)))
        pulls.append(((found.x - x) / found.sigma_x, (found.y - y) / found.sigma_y))
    assert 0.6 < np.sqrt(np.square(pulls).mean()) < 1.25


@pytest.mark.parametrize(("sigma", "quality"), [(1.6, 92), (2.1, 85)])
def test_a_small_dot_in_a_compressed_picture_of_a_wall_has_a_right_error(sigma, quality):
    pulls = []
    for seed in range(80):
        x, y = 160 + 8 * rng(seed).random(2)
        grey = 120 + 115 * scenes.gaussian(x, y, sigma, sigma)[:320, :320]
        grey = grey + rng(seed).normal(0, 1.4, grey.shape)
        colours = np.clip(np.rint(np.dstack([0.8 * grey, grey, 0.9 * grey])), 0, 255).astype(np.uint8)
        found = find_spot(cv2.imdecode(cv2.imencode(".jpg", colours, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 1))
        pulls += [(found.x - x) / found.sigma_x, (found.y - y) / found.sigma_y]
    assert 0.5 < np.sqrt(np.square(pulls).mean()) < 1.25
    assert np.abs(pulls).max() < 5


def test_a_colour_that_is_saturated_does_not_hide_the_place():
    light = hermite(315.4, 246.2, 17, 17)
    for exposure in (1.0, 1.6, 2.4):
        parts = [part * exposure * light + rng(1).normal(size=light.shape) + 6 for part in (235, 35, 95)]
        found = find_spot(np.dstack([np.clip(np.rint(part), 0, 255).astype(np.uint8) for part in parts]))
        assert abs(found.x - 315.4) < 5 * found.sigma_x < 0.7 and abs(found.y - 246.2) < 5 * found.sigma_y


QUICK = ("skewed", "rows", "colour", "small")


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[] if kind in QUICK else pytest.mark.full) for kind in scenes.ONE_BEAM]
)
def test_the_errors_of_a_kind_of_real_beams_are_right(kind):
    """A short run of what tools/bench/spot.py prints; the places are those that mirrormount_sim declares."""
    every = [scenes.real(rng(seed), kind) for seed in range(24)]
    pulls = [
        ((spot.x - scene.truth[0]) / spot.sigma_x, (spot.y - scene.truth[1]) / spot.sigma_y)
        for scene in every
        if (spot := find_spot(scene.image))
    ]
    assert len(pulls) >= LEAST_ANSWERED.get(kind, 22)
    assert 0.6 < np.sqrt(np.square(pulls).mean()) < 1.35


LEAST_ANSWERED = {"saturated": 12, "window": 12}


@pytest.mark.parametrize("kind", ["empty", "two spots", "cut by the edge"])
def test_where_no_one_beam_is_none_is_found(kind):
    assert not any(find_spot(scenes.real(rng(seed), kind).image) for seed in range(20))


def judge(seeds, most_wrong=0.0):
    """(n, 2) errors in standard errors. Of the scenes so many may be above 5, or have a spot where no one is."""
    pulls, failed = [], []
    for seed in seeds:
        scene = scenes.nasty(rng(seed))
        found = find_spot(scene.image, scene.dark)
        if not found:
            continue
        if scene.truth is None:
            failed.append((seed, scene.parts, found))
            continue
        pull = (found.x - scene.truth[0]) / found.sigma_x, (found.y - scene.truth[1]) / found.sigma_y
        pulls.append(pull)
        if max(map(abs, pull)) > 5:
            failed.append((seed, scene.parts, found, scene.truth))
    assert len(pulls) > len(seeds) / 3
    assert len(failed) <= most_wrong * len(seeds), failed
    return np.array(pulls)


def test_a_ghost_of_ten_percent_hot_pixels_and_saturation_move_it_by_less_than_a_tenth_of_a_pixel():
    found = [(scene, find_spot(scene.image)) for scene in (scenes.marred(rng(seed)) for seed in range(40))]
    answered = [(scene, spot) for scene, spot in found if spot]
    assert len(answered) >= 20
    for scene, spot in answered:
        assert spot.saturated > 0
        assert abs(spot.x - scene.truth[0]) < 0.1 and abs(spot.y - scene.truth[1]) < 0.1


@pytest.mark.parametrize(
    ("reason", "light"),
    [
        (NoSpotReason.FLAT, np.zeros((480, 640))),
        (NoSpotReason.NOTHING, None),
        (NoSpotReason.SATURATED, 4000 * scenes.gaussian(300, 200, 20, 20)),
        (NoSpotReason.SPLIT, 100 * (scenes.gaussian(300, 200, 9, 9) + scenes.gaussian(360, 220, 9, 9))),
        (NoSpotReason.SPLIT, 100 * (scenes.gaussian(300, 200, 9, 9) + scenes.gaussian(328, 200, 9, 9))),
        (NoSpotReason.EDGE, 120 * scenes.gaussian(4, 200, 9, 9)),
        (NoSpotReason.WIDE, 120 * scenes.gaussian(320, 240, 150, 150)),
        (NoSpotReason.SHAPE, 120 * scenes.gaussian(300, 200, 30, 5)),
    ],
)
def test_a_refusal_has_its_reason(reason, light):
    if reason is NoSpotReason.FLAT:
        image = light.astype(np.uint8)
    else:
        image = scenes.expose((0 if light is None else light) + np.full((480, 640), 6.0), rng(5))
    found = find_spot(image)
    assert not found
    assert found.reason is reason
    assert str(found) == f"no spot: {reason.words}"


def test_every_reason_has_a_cause_and_a_remedy():
    assert all(reason.cause and reason.remedy for reason in NoSpotReason)
    assert len({reason.code for reason in NoSpotReason}) == len(NoSpotReason)


def test_a_cluster_of_hot_pixels_is_learned_from_a_dark_frame():
    image = scenes.expose(np.full((480, 640), 6.0), rng(6))
    image[100:104, 200:204] = 230
    dark = scenes.expose(np.full((480, 640), 6.0), rng(7))
    dark[100:104, 200:204] = 230
    assert find_spot(image, dark).reason is NoSpotReason.NOTHING
    assert find_spot(image, Dark.of(np.stack([dark, dark]))).reason is NoSpotReason.NOTHING


def test_sixteen_bits_and_colour_give_the_same_place():
    light, noise = spot_scene()
    image = scenes.expose(light, noise)
    red = np.zeros((480, 640, 3), np.uint8)
    red[:, :, 2] = image
    plain, colour, deep = find_spot(image), find_spot(red), find_spot(image.astype(np.uint16) * 200)
    assert (plain.x, plain.y) == (colour.x, colour.y)
    assert abs(plain.x - deep.x) < 0.01


@pytest.mark.parametrize("picture", [np.zeros((480, 640)), np.zeros((8, 8), np.uint8), np.zeros((99, 99, 2), np.uint8)])
def test_an_array_of_another_form_is_refused_in_words(picture):
    with pytest.raises(BadValue, match="a picture has"):
        find_spot(picture)


@pytest.mark.parametrize("picture", [None, "a.png", [[1, 2], [3, 4]], np.uint8(3)])
def test_what_is_no_array_is_refused_in_words(picture):
    with pytest.raises(BadValue, match="a picture is an array of NumPy"):
        find_spot(picture)


def test_an_array_in_the_other_order_of_bytes_or_not_contiguous_gives_the_same_place():
    light, noise = spot_scene()
    image = scenes.expose(light, noise)
    plain = find_spot(image)
    for other in (image.astype(">u2"), np.asfortranarray(image), np.repeat(image, 2, axis=1)[:, ::2]):
        found = find_spot(other)
        assert (found.x, found.y) == pytest.approx((plain.x, plain.y), abs=1e-6)


@pytest.mark.parametrize(("end", "shift"), [(4095, 0), (4095, 4), (1023, 0)])
def test_a_sensor_of_ten_or_twelve_bits_is_saturated_at_its_own_end(end, shift):
    light, noise = spot_scene(peak=1.15 * end, width=12)
    image = np.clip(light + noise.normal(size=light.shape) * 3, 0, end).astype(np.uint16) << shift
    found = find_spot(image)
    assert found.saturated == (image == end << shift).sum() > 50
    bright = np.clip(40 * light, 0, end).astype(np.uint16) << shift
    assert find_spot(bright).reason is NoSpotReason.SATURATED


@pytest.mark.parametrize("cut", [-0.3, 0.3])
def test_a_beam_of_which_an_edge_has_cut_a_side_off_is_where_its_light_is(cut):
    light, noise = spot_scene(2, width=9)
    beyond = 0.8 * (np.arange(640)[None, :] - 300.3 - 9 * cut) + 0.6 * (np.arange(480)[:, None] - 200.7)
    light = (light - 8) / (1 + np.exp(np.clip(beyond / 1.5, -50, 50)))
    found = find_spot(scenes.expose(8 + light, noise))
    x, y = scenes.beams.declared_place(light)
    assert abs(found.x - x) < 5 * found.sigma_x and abs(found.y - y) < 5 * found.sigma_y


def test_a_dark_frame_of_another_size_is_refused():
    light, noise = spot_scene()
    with pytest.raises(BadValue, match="the dark picture has 320 x 240"):
        find_spot(scenes.expose(light, noise), np.zeros((240, 320), np.uint8))
