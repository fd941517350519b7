"""Amounts and positions in a person's units, with parts of a step, on a live virtual board."""

import pytest
from served import wait_for
from supervised import at_work, moving, polled, sent

from mirrormount.device import calibration
from mirrormount.supervise.requests import GoTo, MoveBy, MoveTo

STEP = calibration.Step(200_000, 255, 0)


@pytest.fixture
def worker(lease, tmp_path, monkeypatch):
    """A board of which x has all scales, y none: forward and back differ."""
    monkeypatch.setenv("MIRRORMOUNT_CONFIG", str(tmp_path))
    with at_work(lease) as worker:
        scale = calibration.Scale(0.25, 0.15, STEP, beam_per_mirror=2.0, screen_mm=1000.0)
        calibration.write(worker.mount.board_id, {worker.mount.x.number: scale})
        yield worker


@pytest.mark.parametrize(
    ("request_", "steps"),
    [
        (MoveBy("x", 1.5, "steps"), 1.5),
        (MoveBy("x", -0.25, "steps"), -0.25),
        (MoveBy("x", -300, "beam-urad"), -1.0),  # by the scale of that way
        (MoveTo("x", 0.5, "mm"), 1.25),  # by the mean of both, as positions are shown
    ],
)
def test_an_amount_is_whole_steps_and_then_one_pulse(worker, page, request_, steps):
    worker.request(page, request_)
    wait_for(lambda: worker.state.status.x.position == pytest.approx(steps, abs=2e-3) and not moving(worker), "the end")
    made = [line for line in sent(worker) if "PR" in line or "XU" in line]
    assert ["XU" in line for line in made] == [False] * (abs(steps) >= 1) + [True] * (steps % 1 != 0)


def test_a_whole_position_is_reached_from_between_two_steps(worker, page):
    for request, position in ((MoveBy("x", 1.5, "steps"), 1.5), (GoTo("x", -1), -1), (GoTo("x", 1), 1)):
        worker.request(page, request)
        wait_for(lambda position=position: worker.state.status.x.position == pytest.approx(position, abs=2e-3), "it")
        wait_for(lambda: not moving(worker), "rest")
    assert sum("PA" in line for line in sent(worker)) == 1  # of whole steps


def test_after_a_stop_the_rest_of_a_step_is_not_made(worker, page):
    worker.request(page, MoveBy("x", 3.5, "steps"))
    wait_for(lambda: moving(worker), "the steps")
    worker.stop("the test")
    wait_for(lambda: not moving(worker), "rest")
    polled(worker)
    assert not any("XU" in line for line in sent(worker))


def test_a_client_that_has_gone_before_the_rest_gets_none(worker, page, lease):
    worker.request(page, MoveBy("x", 1.5, "steps"))
    wait_for(lambda: moving(worker), "the step")
    lease.leave(page, page.connection)
    wait_for(lambda: not moving(worker), "rest")
    polled(worker)
    assert not any("XU" in line for line in sent(worker))


@pytest.mark.parametrize(
    ("request_", "why"),
    [
        (MoveBy("y", 1, "mrad"), "y: no scale in the positive direction"),
        (MoveTo("y", 1, "mm"), "y: no scale in the positive direction"),
        (MoveBy("x", 1e-6, "mm"), "is less than the least that can be moved"),
        (MoveTo("x", 1e6, "mm"), "within -999999"),
    ],
)
def test_what_cannot_be_moved_is_refused_in_one_line_and_moves_nothing(worker, page, request_, why):
    worker.request(page, request_)
    wait_for(lambda: page.notices, "the refusal")
    assert why in page.notices[0] and len(page.notices[0].splitlines()) == 1
    assert not any(mnemonic in line for line in sent(worker) for mnemonic in ("PR", "PA", "XU"))
