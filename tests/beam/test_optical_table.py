"""Table.open(): the mounts and cameras of table.toml, supervised; what is missing is told."""

import cv2
import numpy as np
import pytest

from mirrormount import errors
from mirrormount_beam import scale
from mirrormount_beam.cameras import open_camera
from mirrormount_beam.scale import Scale
from mirrormount_beam.table import Table

PATIENCE_S = 60.0  # nobody hangs here
MOUNTS = '[mounts.first]\nport = "virtual://"\n[mounts.second]\nport = "virtual://?seed=2"\nx_axis = 1\n'


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The user's folder for settings, with a folder of one picture beside it."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))
    monkeypatch.delenv("MIRRORMOUNT_TABLE", raising=False)
    (tmp_path / "pictures").mkdir()
    y, x = np.mgrid[:120, :160]
    spot = 20 + 180 * np.exp(-((x - 80.0) ** 2 + (y - 50.0) ** 2) / 200)
    cv2.imwrite(str(tmp_path / "pictures" / "1.png"), spot.astype(np.uint8))
    return tmp_path


def write(folder, cameras: str = "", mounts: str = MOUNTS) -> None:
    (folder / "table.toml").write_text(mounts + cameras)


def camera(folder, more: str = "") -> str:
    return f'[cameras.near]\ncamera = "{folder / "pictures"}"\n{more}'


def save_scale(folder) -> None:
    opened = open_camera(str(folder / "pictures"))
    scale.write(opened, Scale(160, 120, 0.05, 0.0))
    opened.close()


def test_a_table_is_opened_by_its_names(folder):
    write(folder, camera(folder, "distance_mm = 400.0\ntarget_x_px = 70.0\ntarget_y_px = 60.0\n"))
    save_scale(folder)
    with Table.open(PATIENCE_S) as table, table.loop("a loop") as loop:
        assert [actuator.name for actuator in loop.actuators] == ["first.x", "first.y", "second.x", "second.y"]
        eye = loop.cameras[0]
        assert (eye.name, eye.target_px, eye.um_per_px, eye.distance_m) == ("near", (70.0, 60.0), (50.0, 50.0), 0.4)
        spot = eye.find(next(eye.frames()))
        assert (spot.x, spot.y) == pytest.approx((80.0, 50.0), abs=0.1)
        loop.take_control()
        loop.actuators[2].step(1)
        while loop.actuators[2].is_moving():
            loop.sleep(0.03)
        second = table.supervisors["second"]
        assert second.worker.mount.x.number == 1 and second.worker.mount.x.position == 1.0


def test_without_a_target_the_spot_belongs_into_the_middle(folder):
    write(folder, camera(folder))
    save_scale(folder)
    with Table.open(PATIENCE_S) as table:
        assert table.cameras["near"].target_px == (79.5, 59.5)


def test_a_camera_of_the_table_is_asked_for_its_settings(folder):
    write(folder, camera(folder, "exposure = 5.0\n"))
    save_scale(folder)
    with pytest.raises(errors.BadValue, match="is no webcam: it has no exposure to set"):
        Table.open(PATIENCE_S)


def test_two_mounts_on_one_board_share_its_owner(folder):
    write(folder, camera(folder), MOUNTS.replace('"virtual://?seed=2"\nx_axis = 1', '"virtual://"\nx_axis = 4'))
    save_scale(folder)
    with Table.open(PATIENCE_S) as table:
        assert table.supervisors["first"] is table.supervisors["second"]
        assert table.axes == {"first": ("x", "y"), "second": ("axis4", "axis3")}


@pytest.mark.parametrize(
    ("mounts", "with_camera", "error", "why"),
    [
        ("", True, errors.BadFile, "names no mount"),
        (MOUNTS, False, errors.BadFile, "names no camera"),
        (MOUNTS, True, errors.NotCalibrated, "near: no scale is saved"),
    ],
)
def test_what_is_missing_is_told_and_nothing_is_opened(folder, mounts, with_camera, error, why):
    write(folder, camera(folder) if with_camera else "", mounts)
    with pytest.raises(error, match=why):
        Table.open(PATIENCE_S)
