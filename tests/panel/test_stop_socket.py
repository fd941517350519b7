"""`mirrormount stop` while a panel has the port."""

from running import PANEL, Panel
from served import run_process

from mirrormount.device.mount import Mount


def test_stop_gets_through_a_panel(board, tmp_path):
    panel = Panel(str(board.link), tmp_path, program=PANEL)
    try:
        run = run_process("stop", "--port", str(board.link))
        assert (run.returncode, run.stderr) == (0, "")
        assert f"process {panel.process.pid} " in run.stdout and run.stdout.startswith("stop")
    finally:
        panel.kill()
    with Mount.open(str(board.link)) as mount:
        assert not mount.status().moving
