"""A program asks a person for control; the person hands it over, keeps it, and takes it back."""

import pytest
from served import PATIENCE_S, wait_for
from supervised import moving

from mirrormount.errors import MoveEnded, NotInControl
from mirrormount.supervise.lease import Client, Lease
from mirrormount.supervise.requests import Press
from mirrormount.supervise.worker import Worker
from mountfw import codes as wire


@pytest.fixture
def patience_s() -> float:
    return 60.0  # nobody hangs here


def person_in(lease: Lease) -> Client:
    person = Client("page 1", is_person=True)
    lease.join(person, object())
    return person


def press_stop(worker: Worker, person: Client) -> None:
    """As the panel does."""
    worker.stop("STOP was pressed")
    worker.lease.take_over(person, "STOP was pressed")


@pytest.fixture
def lease(supervisor):
    return supervisor.worker.lease


@pytest.fixture
def person(lease) -> Client:
    """A person who has control."""
    return person_in(lease)


@pytest.fixture
def program(supervisor, told):
    with supervisor.join("beam loop", told.append) as program:
        yield program


def test_without_a_person_a_program_that_asks_has_control_at_once(program):
    assert program.ask_for_control().result(0) is None
    assert program.in_control


def test_a_program_that_asks_another_program_is_refused(supervisor, program):
    program.take_control()
    with supervisor.join("scan") as scan, pytest.raises(NotInControl, match="beam loop has control"):
        scan.ask_for_control()


def test_a_person_hands_control_over_and_what_they_moved_is_stopped(supervisor, program, person, lease):
    worker = supervisor.worker
    with supervisor.join("scan") as scan:
        outcome = program.ask_for_control()
        assert program.ask_for_control() is outcome  # one question a program
        assert not outcome.done() and not program.in_control
        assert lease.question.client is program
        later = scan.ask_for_control()
        stops = lease.stops
        worker.hand_over(person, lease.question.number)
        assert outcome.result(PATIENCE_S) is None
        assert lease.stops == stops + 1
        assert program.in_control and lease.holder is program
        assert program.step("x", 1).wait(PATIENCE_S).steps == 1
        assert lease.question.client is scan and not later.done()
    assert later.cancelled() and lease.question is None


def test_a_person_who_keeps_control_keeps_it(program, person, lease):
    outcome = program.ask_for_control()
    lease.keep(person, lease.question.number)
    with pytest.raises(NotInControl, match="page 1 keeps control"):
        outcome.result(PATIENCE_S)
    assert lease.holder is person and lease.question is None
    with pytest.raises(NotInControl):
        program.step("x", 1)
    assert program.ask_for_control() is not outcome


@pytest.mark.parametrize("number", [None, 0, 99, "1", [1]])
def test_an_answer_to_no_question_changes_nothing(supervisor, program, person, lease, number):
    outcome = program.ask_for_control()
    with pytest.raises(NotInControl, match="withdrawn or answered"):
        supervisor.worker.hand_over(person, number)
    with pytest.raises(NotInControl, match="withdrawn or answered"):
        lease.keep(person, number)
    assert lease.holder is person and not outcome.done()


def test_only_the_person_in_control_may_answer(supervisor, program, person, lease):
    other = person_in(lease)
    outcome = program.ask_for_control()
    with pytest.raises(NotInControl, match="does not have control"):
        supervisor.worker.hand_over(other, lease.question.number)
    assert lease.holder is person and not outcome.done()


def test_a_question_that_was_withdrawn_cannot_be_answered(supervisor, program, person, lease):
    outcome = program.ask_for_control()
    number = lease.question.number
    assert outcome.cancel() and lease.question is None
    with pytest.raises(NotInControl, match="withdrawn or answered"):
        supervisor.worker.hand_over(person, number)
    assert lease.holder is person


def test_a_program_that_takes_free_control_meanwhile_has_its_outcome(program, person, lease):
    outcome = program.ask_for_control()
    lease.leave(person, person.connection)
    assert not outcome.done()  # a page that is gone has handed nothing over
    program.take_control()
    assert outcome.result(0) is None and lease.question is None


def test_control_that_was_handed_over_is_taken_back_at_once(supervisor, program, person, lease, told):
    outcome = program.ask_for_control()
    supervisor.worker.hand_over(person, lease.question.number)
    outcome.result(PATIENCE_S)
    motion = program.jog("x", 0.5)
    wait_for(lambda: moving(supervisor.worker), "the jog")
    supervisor.worker.take_control(person)
    with pytest.raises(MoveEnded):
        motion.wait(PATIENCE_S)
    assert told == ["page 1 took control"]
    with pytest.raises(NotInControl, match="page 1 has control"):
        program.take_control()


def test_a_motion_that_another_client_has_stopped_was_aborted_and_not_superseded(supervisor, program, lease):
    program.take_control()
    person = person_in(lease)
    motion = program.jog("x", 0.5)
    wait_for(lambda: moving(supervisor.worker), "the jog")
    supervisor.worker.take_control(person)
    lease.beat(person)
    supervisor.worker.request(person, Press({"x": 1}, 255))  # at once, before the next poll
    with pytest.raises(MoveEnded) as ended:
        motion.wait(PATIENCE_S)
    assert ended.value.reason == wire.ABORTED


def test_stop_on_a_page_takes_control_from_a_program_which_cannot_take_it_again(supervisor, program, lease, told):
    program.take_control()
    person = person_in(lease)
    motion = program.jog("x", 0.5)
    wait_for(lambda: moving(supervisor.worker), "the jog")
    press_stop(supervisor.worker, person)
    with pytest.raises(MoveEnded):
        motion.wait(PATIENCE_S)
    assert lease.holder is person
    with pytest.raises(NotInControl, match="page 1 has control"):
        program.take_control()
    wait_for(lambda: told, "the cause")
    assert told == ["stopped: STOP was pressed"]


def test_stop_on_a_page_that_watches_leaves_control_with_the_person_who_has_it(supervisor, person, lease):
    press_stop(supervisor.worker, person_in(lease))
    assert lease.holder is person
