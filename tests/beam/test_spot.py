"""find_spot on pictures of which the true place of the spot is known."""

import cv2
import numpy as np
import pytest
import scenes

from mirrormount.errors import BadValue
from mirrormount_beam.camera import Dark
from mirrormount_beam.spot import gaussian
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
def test_of_ten_thousand_nasty_scenes_none_has_a_wrong_answer():
    pulls = judge(range(10_000))
    assert 0.92 <= (np.abs(pulls) < 2).mean() <= 0.98


@pytest.mark.parametrize("width", [6.0, 12.0])
@pytest.mark.parametrize("peak", [700.0, 1000.0, 2000.0, 6000.0, 20_000.0])
def test_a_spot_that_is_mostly_saturated_is_refused_for_that(width, peak):
    y, x = np.mgrid[:480, :640]
    light = 6 + peak * np.exp(-((x - 320) ** 2 + (y - 240) ** 2) / (2 * width**2)) + rng(1).normal(0, 1, (480, 640))
    found = find_spot(np.clip(light, 0, 255).astype(np.uint8))
    assert not found
    assert found.reason is NoSpotReason.SATURATED


@pytest.mark.parametrize(
    "seed", [600_844, 715_516], ids=["only its tip is above the threshold", "the fit sees a flank"]
)
def test_a_second_spot_of_which_little_is_seen_is_a_second_spot(seed):
    scene = scenes.nasty(rng(seed))
    assert "two" in scene.parts and scene.truth is None
    found = find_spot(scene.image, scene.dark)
    assert not found
    assert found.reason is NoSpotReason.SPLIT


def test_a_second_spot_that_has_merged_with_the_first_ones_blob_beyond_the_fit_is_a_second_spot():
    scene = scenes.nasty(rng(614_928))
    assert "two" in scene.parts and scene.truth is None
    found = find_spot(scene.image, scene.dark)
    assert not found
    assert found.reason is NoSpotReason.SPLIT
    assert len(found.detection.blobs) == 1


@pytest.mark.parametrize("seed", [625_787, 700_328])
def test_two_spots_of_different_brightness_that_look_like_a_long_one_are_two(seed):
    scene = scenes.nasty(rng(seed))
    assert "two" in scene.parts and scene.truth is None
    found = find_spot(scene.image, scene.dark)
    assert not found
    assert found.reason is NoSpotReason.SPLIT


@pytest.mark.parametrize("seed", [501_141, 620_062])
def test_a_spot_that_something_dark_touches_is_refused_for_its_shape(seed):
    scene = scenes.nasty(rng(seed))
    assert "fly" in scene.parts
    found = find_spot(scene.image, scene.dark)
    assert not found
    assert found.reason is NoSpotReason.SHAPE


def test_the_error_of_a_spot_of_few_speckles_is_that_of_the_speckle():
    pulls = []
    for seed in range(60):
        noise = rng(seed)
        x, y = noise.uniform(100, 380, 2)
        grain = cv2.GaussianBlur(noise.normal(size=(480, 640)), (0, 0), 1.5)
        light = 8 + 50 * scenes.gaussian(x, y, 4.0, 4.0) * (1 + 0.07 * grain / grain.std())
        found = find_spot(scenes.expose(light, noise))
        if found:
            pulls.append(((found.x - x) / found.sigma_x, (found.y - y) / found.sigma_y))
    assert len(pulls) > 50
    assert np.sqrt(np.square(pulls).mean()) < 1
    assert np.abs(pulls).max() < 5


def test_two_spots_that_have_come_to_lie_on_each_other_are_no_fit():
    y, x = (axis.ravel().astype(float) for axis in np.mgrid[:20, :20])
    one = np.array([100.0, 9.6, 10.3, 0.05, 0.0, 0.05, 8.0, 0.0, 0.0])
    bins = gaussian.Bins(x, y, gaussian.evaluate(one, x, y), np.ones_like(x))
    halves = np.concatenate([one, [50.0], one[1:3]])
    halves[0] = 50.0
    assert gaussian.fit(one, bins) is not None
    assert gaussian.fit(halves, bins) is None


def judge(seeds):
    """(n, 2) errors in standard errors; none is above 5, or where no one spot is."""
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
    assert not failed
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
        (NoSpotReason.SPLIT, 100 * (scenes.gaussian(300, 200, 9, 9) + scenes.gaussian(322, 200, 9, 9))),
        (NoSpotReason.EDGE, 120 * scenes.gaussian(4, 200, 9, 9)),
        (NoSpotReason.WIDE, 120 * scenes.gaussian(300, 200, 60, 60)),
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


@pytest.mark.parametrize("cut", [-0.5, -0.3, 0.0])
def test_a_spot_of_which_a_soft_edge_has_cut_one_side_off_is_refused(cut):
    for seed in range(8):
        light, noise = spot_scene(seed, width=5)
        beyond = 0.8 * (np.arange(640)[None, :] - 300.3 - 5 * cut) + 0.6 * (np.arange(480)[:, None] - 200.7)
        assert not find_spot(scenes.expose(8 + (light - 8) / (1 + np.exp(beyond / 1.5)), noise)), seed


def test_a_dark_frame_of_another_size_is_refused():
    light, noise = spot_scene()
    with pytest.raises(BadValue, match="the dark picture has 320 x 240"):
        find_spot(scenes.expose(light, noise), np.zeros((240, 320), np.uint8))
