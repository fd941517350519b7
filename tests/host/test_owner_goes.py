"""The program that has a mount open dies, forks, forgets it, or loses its runtime folder: the mount can be stopped."""

import gc
import os
import shutil
import signal
import subprocess
import sys

import pytest
from served import run_cli, wait_for

from mirrormount import Mount
from mirrormount.transport.stop_socket import owners
from mirrormount.virtual.simulation import BoardGone

if os.name != "posix":
    pytest.skip("fork and Unix sockets need POSIX", allow_module_level=True)

# on a busy computer a board in real time answers later than its client waits
LONG = "m.send('1XM60000;2XM60000'); "  # runs

pytestmark = pytest.mark.usefixtures("runtime")


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_motion_that_send_started_ends_with_the_program(board, holder, how):
    process = holder(str(board.link), f"{LONG}m.send('1MV+')")
    wait_for(board.driving, "the motor to run")
    process.send_signal(how)
    wait_for(lambda: not board.driving(), "the keep-alive")


FORK = """
pid = os.fork()
if not pid:
    try:
        with m:
            m.stop()
    except Exception as e:
        os._exit(7 if 'opened by another process' in str(e) else 8)
    os._exit(9)
assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 7
"""


def test_a_forked_process_is_refused_and_takes_nothing_from_its_parent(board, holder):
    process = holder(str(board.link), f"{LONG}{FORK}m.x.jog(1)")
    wait_for(board.driving, "the motor to run")
    run = run_cli("stop", "--port", str(board.link))
    assert not board.driving()
    assert run.returncode == 0 and f"process {process.pid} " in run.stdout, run.stderr


def test_a_stop_socket_whose_folder_was_removed_comes_back(board, holder, runtime):
    holder(str(board.link), f"{LONG}m.x.jog(1)")
    wait_for(board.driving, "the motor to run")
    shutil.rmtree(runtime)
    wait_for(lambda: owners(str(board.link)), "the socket")
    run = run_cli("stop", "--port", str(board.link))
    assert not board.driving() and run.returncode == 0, run.stderr


def test_a_mount_that_nobody_refers_to_stops_and_gives_its_port_back(board):
    mount = Mount.open(str(board.link))
    mount.send("2XM60000")
    mount.x.jog(1)
    wait_for(board.driving, "the motor to run")
    x = mount.x
    del mount
    gc.collect()
    assert x.run_limit_s == 60  # an axis is enough
    del x
    gc.collect()
    wait_for(lambda: not board.driving(), "the stop")
    Mount.open(str(board.link)).close()


def test_a_mount_that_was_closed_sends_nothing_when_it_is_forgotten(board):
    mount = Mount.open(str(board.link))
    mount.close()
    with Mount.open(str(board.link)) as other:
        other.send("2XM60000;XK0;2MV+")
        del mount
        gc.collect()
        assert other.status().moving


def test_each_of_many_stops_at_once_gets_through(board):
    mount = Mount.open(str(board.link))
    mount.send("2XM60000;XK0;2MV+")
    mount.close()
    wait_for(board.driving, "the motor to run")
    command = [sys.executable, "-m", "mirrormount", "stop", "--port", str(board.link)]
    stops = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(8)]
    said = [stop.communicate() for stop in stops]
    assert [stop.returncode for stop in stops] == [0] * 8, said
    assert not board.driving()


def test_a_program_that_takes_no_stop_is_named_and_no_way_is_told_that_does_not_lead_to_it(board):
    import serial

    with serial.Serial(str(board.link), exclusive=True):
        run = run_cli("stop", "--port", str(board.link))
    assert run.returncode == 1 and run.stdout == ""
    assert "takes no stop from here: end it" in run.stderr and "without --port" not in run.stderr


def test_what_is_forgotten_in_lockstep_ends_its_board():
    simulation = Mount.open("virtual://?speed=max").link.port.simulation
    gc.collect()
    with pytest.raises(BoardGone):
        simulation.go(simulation.now_us + 1_000, 1, b"")
