"""What a loop drives on real boards: supervised mounts, and cameras that come back."""

import pytest

from mirrormount.device.mount import Mount
from mirrormount.errors import BadFile, MoveEnded, NotInControl
from mirrormount.supervise.lease import Client
from mirrormount.supervise.supervisor import Supervisor
from mirrormount_beam.camera import Controls, Image, Size
from mirrormount_beam.errors import CameraAbsent, CameraGone, CameraSizeChanged
from mirrormount_beam.table import SharedTable, TargetCamera, answer

PATIENCE_S = 60.0  # nobody hangs here


def finish(table, actuator) -> None:
    """Until the actuator is at rest."""
    while actuator.is_moving():
        table.sleep(0.03)


@pytest.fixture
def supervised():
    with (
        Supervisor("virtual://", patience_s=PATIENCE_S) as first,
        Supervisor("virtual://", patience_s=PATIENCE_S) as second,
    ):
        mounts = [("first", first, ("x", "y")), ("second", second, ("x", "y"))]
        with SharedTable("hold", mounts, ()) as table:
            yield table, first, second


def test_a_loop_drives_what_it_has_control_of(supervised):
    table, _, second = supervised
    assert table.taken_over, "control is taken, never assumed"
    table.take_control()
    assert table.taken_over == ""
    table.actuators[0].step(1)
    table.actuators[3].pulse(20_000)
    for actuator in table.actuators:
        finish(table, actuator)
    assert second.status.y.position == pytest.approx(0.1, abs=0.01)


def test_its_own_stop_leaves_it_in_control_and_the_motors_off(supervised):
    table, first, _ = supervised
    table.take_control()
    table.actuators[0].step(50)
    table.stop()
    with pytest.raises(MoveEnded):
        finish(table, table.actuators[0])
    assert table.taken_over == "" and not first.status.moving
    table.actuators[0].step(1)
    finish(table, table.actuators[0])


def test_anybody_elses_stop_ends_its_control_until_it_is_told_to_go_on(supervised):
    table, first, _ = supervised
    table.take_control()
    table.actuators[1].step(50)
    first.stop("the user pressed STOP")
    with pytest.raises(MoveEnded):
        finish(table, table.actuators[1])
    table.sleep(60)  # ends when control is lost
    assert "the user pressed STOP" in table.taken_over
    with pytest.raises(NotInControl):
        table.actuators[0].step(1)
    table.take_control()
    assert table.taken_over == ""


def test_a_person_takes_one_mount_and_has_both_stand_still(supervised):
    table, first, _ = supervised
    table.take_control()
    person = Client("page of Ada", is_person=True)
    first.worker.lease.join(person, person)
    first.worker.take_control(person)
    assert "page of Ada took control" in table.taken_over
    with pytest.raises(NotInControl, match="page of Ada has control"):
        table.take_control()
    with pytest.raises(NotInControl):
        table.actuators[2].step(1)


def test_the_loop_needs_no_setting_of_a_mount_and_changes_none(supervised):
    table, first, _ = supervised
    own = {axis: {"take_up_us": 300_000, "velocity": 1.0} for axis in ("x", "y")}
    answer(first.ask(lambda mount: mount.apply(own)))
    before = answer(first.ask(Mount.settings))
    table.take_control()
    for n in (3, -3):
        table.actuators[0].step(n)
        assert answer(first.ask(Mount.settings)) == before
        finish(table, table.actuators[0])
    assert answer(first.ask(Mount.settings)) == before
    on_time_s = answer(first.ask(lambda mount: mount.x.last_move().on_time_s))
    assert on_time_s == pytest.approx(0.6, abs=0.01)  # three steps back, and nothing for the gap


class _Camera:
    """Yields one frame, and fails then."""

    name = "test"
    controls = Controls(None, None)

    def __init__(self, size: Size) -> None:
        self.size = size
        self.closed = False

    def monotonic(self) -> float:
        return 0.0

    def close(self) -> None:
        self.closed = True

    def frames(self):
        yield Image(None, 0.0, 0)
        raise CameraGone("test was unplugged")


def test_a_camera_that_comes_back_is_opened_again_and_must_have_its_size():
    first = _Camera(Size(640, 480))
    cameras = iter([None, _Camera(Size(640, 480)), _Camera(Size(320, 240))])

    def reopen():
        camera = next(cameras)
        if camera is None:
            raise CameraAbsent("not back yet")
        return camera

    eye = TargetCamera("near", first, (320.0, 240.0), (50.0, 50.0), 0.4, reopen=reopen)
    frames = eye.frames()
    next(frames)
    with pytest.raises(CameraGone):
        next(frames)
    with pytest.raises(CameraAbsent):
        next(eye.frames())
    assert first.closed
    frames = eye.frames()
    assert next(frames).number == 0
    with pytest.raises(CameraGone):
        next(frames)
    with pytest.raises(CameraSizeChanged, match="came back with 320 x 240"):
        next(eye.frames())


def test_a_camera_is_waited_for_while_table_toml_cannot_be_read():
    back = _Camera(Size(640, 480))
    edited = iter([True, False])

    def reopen():
        if next(edited):
            raise BadFile("table.toml, line 3: no value")
        return back

    eye = TargetCamera("near", _Camera(Size(640, 480)), (320.0, 240.0), (50.0, 50.0), 0.4, reopen=reopen)
    frames = eye.frames()
    next(frames)
    with pytest.raises(CameraGone):
        next(frames)
    with pytest.raises(CameraGone, match=r"near: it is not opened again: table\.toml, line 3"):
        next(eye.frames())
    next(eye.frames())
    assert eye.camera is back
