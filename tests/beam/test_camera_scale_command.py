"""`mirrormount camera scale`: what it saves, what it keeps, and each wrong input in one line."""

import cv2
import numpy as np
import pytest

from mirrormount.cli.main import main
from mirrormount.errors import NotCalibrated
from mirrormount_beam import scale
from mirrormount_beam.cameras import open_camera
from mirrormount_beam.estimates import Estimate
from mirrormount_beam.scale import Optics


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A camera: a folder with a picture of a checkerboard, 40 pixels a square, 9 x 6 inner corners."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "settings"))
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    squares = np.kron(np.indices((7, 10)).sum(axis=0) % 2, np.ones((40, 40))) * 200 + 30
    cv2.imwrite(str(pictures / "1.png"), np.pad(squares, 40, constant_values=230).astype(np.uint8))
    monkeypatch.setenv("MIRRORMOUNT_CAMERA", str(pictures))
    return pictures


def saved(folder):
    return scale.read(open_camera(str(folder)))


def test_a_ruler_saves_millimetres_a_pixel_and_angles(folder, capsys):
    words = "ruler 10 20 250 340 20 --error 0.08 --distance 1500 --distance-error 5 --incidence 45"
    assert main(["camera", "scale", *words.split()]) == 0
    assert "33.33 ± " in capsys.readouterr().out
    found = saved(folder)
    assert (found.mm_per_px, found.distance_mm, found.sigma_distance_mm, found.incidence_deg) == (0.05, 1500, 5, 45)


def test_a_value_that_cannot_be_written_again_is_told_with_its_file_which_stays(folder, capsys):
    scale.path().parent.mkdir()
    scale.path().write_text("days = [1, 2]\n")
    assert main(["camera", "scale", "pitch", "3"]) == 1
    err = capsys.readouterr().err
    assert err.startswith(f"mirrormount: {scale.path()}: days = [1, 2] is no number") and err.count("\n") == 1
    assert scale.path().read_text() == "days = [1, 2]\n"


def test_a_checkerboard_in_the_picture_is_measured(folder, capsys):
    assert main(["camera", "scale", "checkerboard", "9", "6", "5"]) == 0
    assert "angles need --distance" in capsys.readouterr().out
    assert saved(folder).mm_per_px == pytest.approx(0.125, rel=1e-3)


def test_what_is_not_given_stays_as_it_was(folder, capsys):
    assert main(["camera", "scale", "pitch", "3", "--distance", "1500"]) == 0
    assert main(["camera", "scale", "geometry", "--incidence", "45"]) == 0
    assert "distance as saved before" in capsys.readouterr().out
    assert (saved(folder).mm_per_px, saved(folder).distance_mm, saved(folder).incidence_deg) == (0.003, 1500, 45)


def test_an_angle_of_incidence_that_nobody_gave_is_not_known(folder, capsys):
    for words in ("pitch 3", "pitch 3 --distance 1500"):
        assert main(["camera", "scale", *words.split()]) == 0
    out = capsys.readouterr().out
    assert "angle of incidence       not known" in out and "as saved before" not in out
    found = saved(folder)
    assert found.incidence_deg is None
    assert found.mirror_mrad(scale.Measured(1, 0), in_plane=True).value == pytest.approx(0.001)
    with pytest.raises(NotCalibrated, match="angle of incidence"):
        found.mirror_mrad(scale.Measured(1, 0), in_plane=False)
    of_axes = Optics(found)
    assert of_axes.mirror_urad(Estimate(1, 0, "px"), "x") and of_axes.mirror_urad(Estimate(1, 0, "px"), "y") is None


def test_the_help_says_that_an_angle_that_is_not_given_is_not_known(capsys):
    with pytest.raises(SystemExit):
        main(["camera", "scale", "ruler", "--help"])
    words = " ".join(capsys.readouterr().out.split())
    assert "between beam and mirror's normal (default: as saved before, else not known)" in words


@pytest.mark.parametrize("command", ["camera scale pitch 3", "scan line 1 0 1", "measure steps"])
def test_a_saved_scale_of_another_size_is_not_left_out_in_silence(command, folder, capsys):
    assert main(["camera", "scale", "pitch", "5", "--distance", "1500"]) == 0
    cv2.imwrite(str(folder / "1.png"), np.indices((240, 320)).sum(axis=0).astype(np.uint8))
    main([*command.split(), *(["--port", "virtual://"] * ("camera" not in command))])
    err = capsys.readouterr().err
    assert "note: the scale of pictures is of 480 x 360 pixels, and the camera has 320 x 240: run" in err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("show", "no scale is saved for pictures"),
        ("geometry --distance 1500", "run `mirrormount camera scale`"),
        ("geometry", "give --distance or --incidence"),
        ("geometry --incidence 90", "0 to less than 90 degrees"),
        ("geometry --distance-error 3", "--distance-error needs --distance"),
        ("pitch 3 --distance 0", "--distance is above 0"),
        ("pitch 3 --error -1", "--error is 0 or more"),
        ("pitch 500", "0.1 to 100 um"),
        ("pitch nan", "UM is"),
        ("ruler 1 2 3 4 5", "at least 10 pixels apart"),
        ("ruler 1 2 900 4 5", "not in the picture of 480 x 360 pixels"),
        ("ruler a 2 300 4 5", "X1 is a number"),
        ("ruler 1 2 300 4 0", "MM is more than 0"),
        ("ruler 1 2 300 4 50 --error 50", "--error is less than MM"),
        ("pitch 3 --distance 500 --distance-error 500", "--distance-error is less than --distance"),
        ("checkerboard 8 7 5", "no checkerboard with 8 x 7"),
        ("checkerboard 2 6 5", "inner corners, 3 … 30"),
    ],
)
def test_wrong_input_is_one_line_and_nothing_is_saved(words, says, capsys):
    assert main(["camera", "scale", *words.split()]) == 1
    out, err = capsys.readouterr()
    assert says in err and err.count("\n") == 1 and out == ""
    assert not scale.path().exists()
