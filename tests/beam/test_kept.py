"""Back to a kept position by the beam, on virtual tables: where the spot truly is, and what is refused."""

import contextlib
import math
from dataclasses import replace

import pytest

from mirrormount.cli import presets as command
from mirrormount.cli.main import main
from mirrormount.cli.main import parser as whole_parser
from mirrormount.device.mount import Mount
from mirrormount.errors import MountError
from mirrormount.transport.link import Link
from mirrormount_beam import kept
from mirrormount_beam.cli.kept import KeptSpot
from mirrormount_beam.errors import CannotCompare, SpotLost
from mirrormount_beam.observe import SpotObserver
from mirrormount_beam.pointing import WITHIN_PX
from mirrormount_sim.table import open_table


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path / "data"))


@contextlib.contextmanager
def opened(options: str = ""):
    with open_table(f"virtual-table://?mounts=1{options}") as table, Mount(Link(table.ports[0])) as mount:
        yield table, mount, table.cameras[1]


def true_px(table, camera) -> tuple[float, float]:
    """The spot of now, in the camera's picture, without any camera."""
    number = table.cameras.index(camera)
    return camera.truth_px(table.truth.spots_mm(table.now_s())[number])


def disturb(mount: Mount) -> None:
    """Away and back to the same numbers: from the other side, so that the backlash hides the place."""
    for axis in (mount.x, mount.y):
        axis.step(-6)
        axis.step(3)


@pytest.mark.parametrize("options", ["&profile=smooth", "&profile=hardware&seed=2", "&profile=rough&seed=3"])
def test_the_spot_is_back_where_it_was_where_steps_alone_miss_it(options):
    with opened(options) as (table, mount, camera):
        for axis in (mount.x, mount.y):
            axis.step(3)
        mount.presets.keep("good", spot=kept.seen(SpotObserver(camera)))
        before = true_px(table, camera)
        disturb(mount)
        preset = mount.presets.back("good")
        by_steps = math.dist(true_px(table, camera), before)
        arrival = kept.bring(mount, camera, preset)
        assert arrival.reached and preset.spot
        # the tolerance, and what two means of images in moving air are worth
        assert math.dist(true_px(table, camera), before) < WITHIN_PX + 0.5 < by_steps
        assert kept.off(preset.spot, arrival).startswith("the spot is 0.")


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"camera": "another one"}, "was kept with the camera another one"),
        ({"width": 320}, "in a picture of 320 x 480 pixels, and the camera has 640 x 480"),
        (None, "was kept without a spot"),
    ],
)
def test_what_cannot_be_compared_is_refused_and_nothing_moves(change, why):
    with opened() as (_, mount, camera):
        preset = mount.presets.keep("good", spot=kept.seen(SpotObserver(camera)))
        preset = replace(preset, spot=change and replace(preset.spot, **change))
        with pytest.raises(CannotCompare, match=why):
            kept.bring(mount, camera, preset)
        assert (mount.x.position, mount.y.position) == (0, 0)


def test_a_spot_that_is_not_seen_is_neither_kept_nor_brought_back():
    with opened() as (_, mount, camera):
        preset = mount.presets.keep("good", spot=kept.seen(SpotObserver(camera)))
        mount.x.step(300)
        with pytest.raises(SpotLost):
            kept.seen(SpotObserver(camera))
        with pytest.raises(SpotLost):
            kept.bring(mount, camera, preset)
        assert (mount.x.position, mount.y.position) == (300, 0)


# ---- the shell: with the mount and the camera of one table


@pytest.fixture
def shell(monkeypatch):
    """run(words): a command's output or its error, on the mount and the camera of one table."""
    with opened("&profile=hardware") as (table, mount, camera):
        monkeypatch.setattr(command, "open_mount", lambda _: contextlib.nullcontext(mount))
        monkeypatch.setattr(command, "spot_of", KeptSpot)
        monkeypatch.setattr("mirrormount_beam.cli.kept.open_beside_mount", lambda *_: _Open(camera))

        def run(*words: str) -> None:
            args = whole_parser([words[0]]).parse_args(words)
            args.run(args)

        yield run, mount, table, camera


class _Open:
    """The table's camera, which a command closes."""

    def __init__(self, camera) -> None:
        self._camera = camera

    def __getattr__(self, name: str):
        return getattr(self._camera, name)

    def close(self) -> None:
        pass


def test_the_shell_keeps_the_spot_and_says_how_far_off_it_ends(shell, capsys):
    run, mount, table, camera = shell
    run("keep", "good", "--camera", "0")
    assert "; the spot at (" in capsys.readouterr().out
    before = true_px(table, camera)
    disturb(mount)
    run("back", "good", "--camera", "0")
    out = capsys.readouterr().out
    assert "; the spot is 0." in out and " um, " in out and "urad of the beam)" in out and out.count("\n") == 1
    assert math.dist(true_px(table, camera), before) < WITHIN_PX + 0.5


def test_the_shell_says_where_the_mount_is_when_the_spot_is_lost_on_the_way(shell, capsys, monkeypatch):
    run, mount, _, _ = shell
    run("keep", "good", "--camera", "0")

    def lost(*_: object):
        mount.x.step(4)
        raise SpotLost("no spot")

    monkeypatch.setattr(kept, "approach", lost)
    with pytest.raises(SpotLost):
        run("back", "good", "--camera", "0")
    assert "from there the camera's way ended at x: +7.000" in capsys.readouterr().err


def test_the_shell_refuses_before_anything_moves_what_was_kept_without_a_spot(shell):
    run, mount, _, _ = shell
    run("keep", "good")
    disturb(mount)
    with pytest.raises(MountError, match="good was kept without a spot"):
        run("back", "good", "--camera", "0")
    assert (mount.x.position, mount.y.position) == (-3, -3)
    run("back", "good")
    assert (mount.x.position, mount.y.position) == (0, 0)


def test_options_of_a_camera_without_one_and_a_camera_of_another_table_are_refused_in_one_line(capsys):
    for words, why in (
        (("--roi", "0,0,64,64"), "roi: of a camera; add --camera"),
        (("--camera", "virtual-table://"), "sees the mounts of its own table only"),
    ):
        assert main(["keep", "good", "--port", "virtual://?speed=max", *words]) == 1
        told = capsys.readouterr().err
        assert why in told and told.count("\n") == 1
