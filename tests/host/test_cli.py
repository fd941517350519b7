"""The shell command: each wrong input is one clear line and status 1, and nothing moves."""

import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest
from served import PATIENCE_S, run_cli, run_process, wait_for

import mirrormount.transport.discovery
import mirrormount.transport.ports
from mirrormount.cli import main
from mirrormount.device.mount import Mount

VIRTUAL = ("--port", "virtual://?speed=max")


def one_line(run: subprocess.CompletedProcess) -> str:
    assert run.returncode == 1, (run.stdout, run.stderr)
    assert run.stderr.startswith("mirrormount: ")
    message, *rest = run.stderr.splitlines(keepends=True)
    assert [line.split()[0] for line in rest] in ([], ["cause:", "remedy:"]), run.stderr
    return message


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("drive", "fast", "0"), "M1 is a whole number, not 'fast'"),
        (("drive", "256", "0"), "within -255"),
        (("drive", "1_00", "0"), "M1 is a whole number, not '1_00'"),
        (("step", "x", "1_000"), "N is a number, not '1_000'"),
        (("step", "x", "1e-400"), "nearer to 0"),
        (("step", "x", "far"), "N is a number, not 'far'"),
        (("step", "x", "99999999"), "N is out of range: within -1000000 … 1000000, not 99999999"),
        (("step", "x", "1", "mm"), "mm needs screen_mm"),
        (("move", "y", "far"), "POSITION is a number, not 'far'"),
        (("move", "y", "nan"), "out of range"),
        (("move", "y", "1", "mm"), "mm needs screen_mm"),
        (("move", "y", "\u0661"), "a number"),
        (("jog", "x", "nan"), "out of range"),
        (("jog", "x", "2"), "within -1"),
        (("jog", "x", "0.001"), "1/255"),
        (("jog", "x", "0.5", "--seconds", "11"), "10 s at most"),
        (("step", "x", "\u0661"), "N is a number"),
        (("status", "--port", "socket://no.such.host.invalid:5"), "no such host"),
        (("jog", "x", "0.5", "--seconds", "-1"), "more than 0"),
        (("step", "x", "5", "--port", ""), "empty"),
        (("status", "--port", "/dev/does-not-exist"), "no such port"),
        (("status", "--port", "socket://127.0.0.1:9"), "nothing listens"),
        (("status", "--port", "virtual://?bench=moon"), "no bench"),
        (("status", "--port", "gopher://x"), "not a port's address"),
        (("demo", "--port", "/dev/ttyACM0"), "virtual"),
        (("home", "x"), "235: x not fitted or switched off"),
    ],
)
def test_wrong_input_is_one_line(words, says):
    arguments = words if "--port" in words else (*words, *VIRTUAL)
    assert says in one_line(run_cli(*arguments))


def test_what_works_prints_what_happened():
    run = run_cli("step", "x", "3", *VIRTUAL)
    assert (run.returncode, run.stdout) == (0, "x: moved +3 steps, now at +3 (unknown)\n")
    run = run_cli("status", *VIRTUAL)
    assert run.stdout.startswith("mirrormount,Raspberry Pi Pico,") and "unknown" in run.stdout
    assert run_cli("stop", *VIRTUAL).stdout == "stopped\n"
    assert run_cli("drive", "100", "-100", "--seconds", "0.2", *VIRTUAL).returncode == 0
    assert run_cli("jog", "y", "-0.5", "--seconds", "0.2", *VIRTUAL).returncode == 0


def test_driving_at_nothing_is_off_and_no_error():
    assert run_cli("drive", "0", "0", *VIRTUAL).returncode == 0


def test_a_command_line_can_be_sent_and_its_refusal_is_told():
    assert run_cli("send", "2XI1;2XI?;VE?", *VIRTUAL).stdout == "1; MM2 Version 0.3.0 mirrormount\n"
    assert run_cli("send", "1DH3", *VIRTUAL).stdout == ""
    reset = run_cli("send", "*rst", *VIRTUAL)
    assert (reset.returncode, reset.stdout, reset.stderr) == (0, "", "")
    assert "7: parameter out of range" in one_line(run_cli("send", "1XP5", *VIRTUAL))
    assert "printable" in one_line(run_cli("send", "1XP5\n", *VIRTUAL))


def test_errors_that_wait_are_shown_by_status_and_by_nothing_else_in_silence(board):
    with open(board.link, "wb", buffering=0) as raw:
        raw.write(b"\nAT\n")
    step = run_process("step", "x", "0", "--port", board.tcp)  # where a warning of the log goes to stderr
    assert "the board reports 6" in step.stderr
    with open(board.link, "wb", buffering=0) as raw:
        raw.write(b"\nAT\n")
    status = run_cli("status", "--port", board.tcp)
    assert "error 6, COMMAND DOES NOT EXIST" in status.stdout


@pytest.mark.parametrize("name", ["missing/square.png", "folder.png", "square", "square.xyz"])
def test_a_picture_that_cannot_be_written_is_one_line_before_anything_runs(tmp_path, name):
    (tmp_path / "folder.png").mkdir()
    run = run_cli("demo", "--output", str(tmp_path / name))
    one_line(run)
    assert run.stdout == ""


def test_no_board_is_one_line(monkeypatch, capsys):
    monkeypatch.setattr(mirrormount.transport.discovery.list_ports, "comports", list)
    monkeypatch.delenv("MIRRORMOUNT_PORT", raising=False)
    assert main.main(["status"]) == 1
    assert "no board found" in capsys.readouterr().err


def port(device: str, vid: int | None, pid: int | None) -> SimpleNamespace:
    return SimpleNamespace(device=device, vid=vid, pid=pid)


def test_two_boards_are_named_and_neither_is_opened(monkeypatch, capsys):
    ports = [port("/dev/ttyACM1", 0x2E8A, 5), port("/dev/ttyACM0", 0x2E8A, 5)]
    monkeypatch.setattr(mirrormount.transport.discovery.list_ports, "comports", lambda: ports)
    monkeypatch.setattr(mirrormount.transport.ports, "SerialPort", None)  # opening anything would fail loudly
    monkeypatch.delenv("MIRRORMOUNT_PORT", raising=False)
    assert main.main(["status"]) == 1
    assert "/dev/ttyACM0, /dev/ttyACM1" in capsys.readouterr().err


def test_other_instruments_are_not_considered(monkeypatch):
    ports = [
        port("/dev/ttyUSB0", 0x0403, 0x6001),
        port("/dev/ttyS0", None, None),
        port("/dev/ttyACM3", 0x2341, 0x43),
    ]
    monkeypatch.setattr(mirrormount.transport.discovery.list_ports, "comports", lambda: ports)
    assert mirrormount.transport.discovery.find() == []


def test_a_busy_port_is_one_line(board):
    from mirrormount.device.mount import Mount

    with Mount.open(str(board.link)) as mount:
        mount.x.jog(0.2)
        assert "another program" in one_line(run_process("status", "--port", str(board.link)))


def test_ctrl_c_stops_the_motion_and_is_one_line(board):
    jog = subprocess.Popen(
        [sys.executable, "-m", "mirrormount", "jog", "x", "0.5", "--port", str(board.link)],
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for(board.driving, "the motor to run")
    jog.send_signal(signal.SIGINT)
    _, err = jog.communicate(timeout=PATIENCE_S)
    assert jog.returncode == 130
    assert err.startswith("mirrormount: stopped at x: +") and err.count("\n") == 1
    assert not board.driving()


def test_stop_stops_what_another_client_left_running(board):
    with open(board.link, "wb", buffering=0) as raw:
        raw.write(b"1XM60000;1MV+\n")
    wait_for(board.driving, "the motor to run")
    assert run_cli("stop", "--port", str(board.link)).stdout == "stopped\n"
    assert not board.driving()


def test_a_port_that_closes_in_mid_move_is_one_line(board):
    jog = subprocess.Popen(
        [sys.executable, "-m", "mirrormount", "jog", "x", "0.5", "--port", str(board.link)],
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for(board.driving, "the motor to run")
    board.kill()
    _, err = jog.communicate(timeout=PATIENCE_S)
    assert jog.returncode == 1
    assert err.startswith("mirrormount: ") and err.count("\n") == 1, err


def test_the_port_may_come_from_the_environment(board, monkeypatch, capsys):
    monkeypatch.setenv("MIRRORMOUNT_PORT", board.tcp)
    assert main.main(["step", "y", "1"]) == 0
    assert capsys.readouterr().out == "y: moved +1 steps, now at +1 (unknown)\n"


@pytest.mark.parametrize(
    ("words", "port", "told"),
    [
        (("status",), "/dev/does-not-exist", "there is no such port (see: mirrormount ports)"),
        (("stop",), "/dev/does-not-exist", "there is no such port (see: mirrormount ports)"),
        (("step", "x", "5"), "", "leave it out, or give one (see: mirrormount ports)"),
        (("undeploy",), "virtual://", "virtual://: mirrormount ports lists them"),
        (("status",), "socket://127.0.0.1:9", "nothing listens there"),
    ],
)
def test_a_wrong_port_of_the_environment_is_told_with_the_variables_name(words, port, told, monkeypatch, capsys):
    monkeypatch.setenv("MIRRORMOUNT_PORT", port)
    assert main.main([*words]) == 1
    assert capsys.readouterr().err.endswith(f"{told}; MIRRORMOUNT_PORT names that port\n")
    assert main.main([*words, "--port", port or "/dev/does-not-exist"]) == 1
    assert "MIRRORMOUNT_PORT" not in capsys.readouterr().err


def test_stopping_a_board_imports_nothing_heavy():
    code = (
        "import sys; from mirrormount.cli import main; import mirrormount.device.mount;"
        "import mirrormount.transport.ports; main.parser(['stop']);"
        "heavy = ('numpy', 'matplotlib', 'mirrormount_sim', 'platformdirs', 'tomllib');"
        "print([m for m in heavy if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"


def test_a_stop_by_the_program_that_has_the_port_imports_next_to_nothing():
    code = (
        "import sys; from mirrormount.cli import main;"
        "from mirrormount.transport.stop_socket import StopListener;"
        "owner = StopListener(['/dev/mount'], lambda: 'stopped');"
        "status = main.main(['stop', '--port', '/dev/mount']); owner.close();"
        "print(status, sorted(m for m in sys.modules if m.split('.')[0] in ('serial', 'numpy', 'asyncio', 'logging')"
        " or m.startswith(('mirrormount.device.', 'mirrormount.deploy.', 'mirrormount.serve'))))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    said, imported = run.stdout.splitlines()
    assert said.startswith("stopped (by process ")
    assert imported == "0 []"


def test_home_drives_to_the_switch_and_says_so(tmp_path):
    port = f"virtual://?speed=max&bench=switches&files={tmp_path}"
    with Mount.open(port) as mount:
        mount.apply({"x": {"switches": 3}})
        mount.save()
    assert run_cli("home", "x", "--port", port).stdout == "x: at home\n"
