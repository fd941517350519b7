"""The program that has a mount open dies, forgets it, or loses its runtime folder: the mount can be stopped."""

import gc
import os
import shutil
import signal
import subprocess
import sys

import pytest
from served import run_cli, wait_for

from mirrormount.device.mount import Mount
from mirrormount.transport.stop_socket import owners

if os.name != "posix":
    pytest.skip("Unix sockets need POSIX", allow_module_level=True)

# on a busy computer a board in real time answers later than its client waits
LONG = "m.send('1XM60000;2XM60000'); "  # runs

pytestmark = pytest.mark.usefixtures("runtime")


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_motion_that_send_started_ends_with_the_program(board, holder, how):
    process = holder(str(board.link), f"{LONG}m.send('1MV+')")
    wait_for(board.driving, "the motor to run")
    process.send_signal(how)
    wait_for(lambda: not board.driving(), "the keep-alive")


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


def test_each_of_two_stops_at_once_gets_through(board):
    mount = Mount.open(str(board.link))
    mount.send("2XM60000;XK0;2MV+")
    mount.close()
    wait_for(board.driving, "the motor to run")
    command = [sys.executable, "-m", "mirrormount", "stop", "--port", str(board.link)]
    stops = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    said = [stop.communicate() for stop in stops]
    assert [stop.returncode for stop in stops] == [0] * 2, said
    assert not board.driving()


def test_a_program_that_takes_no_stop_is_named_and_no_way_is_told_that_does_not_lead_to_it(board):
    import serial

    with serial.Serial(str(board.link), exclusive=True):
        run = run_cli("stop", "--port", str(board.link))
    assert run.returncode == 1 and run.stdout == ""
    assert "takes no stop from here: end it" in run.stderr
