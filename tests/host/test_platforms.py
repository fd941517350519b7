"""Windows and macOS as far as they can be faked: nothing of the host needs a POSIX module to be imported or to
drive a virtual board, and what differs between systems is chosen rightly."""

import argparse
import errno
import socket
import subprocess
import sys
from types import SimpleNamespace

import pytest
import serial

from mirrormount import errors
from mirrormount.transport import ports as ports_module
from mirrormount_sim import cli as virtual

WITHOUT_POSIX = """
import importlib, os, pkgutil, sys
import nicegui.ui, numpy, serial.tools.list_ports, urllib.request, uvicorn  # theirs to care for
import cv2, h5py, matplotlib.figure  # the same
for name in ("fcntl", "termios", "pty", "tty", "resource", "pwd", "grp"):
    sys.modules[name] = None  # an import of it fails
sys.platform = {platform!r}
import mirrormount
for module in pkgutil.walk_packages(mirrormount.__path__, "mirrormount."):
    if ".fakes" not in module.name and ".boot_" not in module.name and not module.name.endswith("__main__"):
        importlib.import_module(module.name)
from mirrormount.cli import main
sys.exit(main.main(["step", "x", "1", "--port", "virtual://"]))
"""


@pytest.mark.parametrize("platform", ["win32", "darwin"])
def test_the_host_imports_and_drives_a_virtual_board_without_posix_modules(platform):
    code = WITHOUT_POSIX.format(platform=platform)
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert (run.returncode, run.stdout) == (0, "x: moved +1 steps, now at +1 (unknown)\n"), run.stderr


@pytest.fixture
def windows(monkeypatch):
    monkeypatch.setattr(virtual, "os", SimpleNamespace(name="nt", strerror=str))
    monkeypatch.setattr(ports_module.sys, "platform", "win32")


def test_on_windows_a_virtual_board_is_served_on_tcp(windows):
    ports = virtual._ports(argparse.Namespace(tcp=None, link=None))
    try:
        assert [port.address[:19] for port in ports] == ["socket://127.0.0.1:"]
    finally:
        for port in ports:
            port.close()


def test_on_windows_a_pty_is_refused_with_the_remedy(windows, tmp_path):
    with pytest.raises(errors.BadValue, match="--tcp"):
        virtual._ports(argparse.Namespace(tcp=None, link=tmp_path / "mount"))


@pytest.mark.parametrize(("present", "error"), [(["COM4"], errors.PortBusy), ([], errors.PortAbsent)])
def test_on_windows_a_port_that_does_not_open_is_busy_if_it_is_there_and_absent_if_not(
    windows, monkeypatch, present, error
):
    # pyserial gives no error number there, so the list of ports decides
    ports = [SimpleNamespace(device=device) for device in present]
    monkeypatch.setattr(ports_module.list_ports, "comports", lambda: ports)
    assert type(ports_module.explain_open_error("com4", serial.SerialException("could not open port"))) is error


def test_on_windows_permission_denied_does_not_name_linux(windows):
    assert "dialout" not in str(ports_module.explain_open_error("COM4", PermissionError(13, "Access is denied")))


@pytest.mark.parametrize(
    ("cause", "error"),
    [
        (OSError(errno.EBUSY, "Device or resource busy"), errors.PortBusy),
        (OSError(errno.EAGAIN, "Resource temporarily unavailable"), errors.PortBusy),
        (OSError(errno.EPERM, "Operation not permitted"), errors.PermissionDenied),
        (OSError(errno.EACCES, "Permission denied"), errors.PermissionDenied),
        (OSError(errno.ENOENT, "No such file or directory"), errors.PortAbsent),
        (OSError(errno.ECONNREFUSED, "Connection refused"), errors.PortAbsent),
        (OSError(errno.ENOTTY, "Inappropriate ioctl for device"), errors.CannotOpen),
        (TimeoutError(), errors.PortAbsent),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), errors.PortAbsent),
        (serial.SerialException("no number"), errors.CannotOpen),
    ],
)
def test_each_cause_of_a_port_that_does_not_open_has_its_error(monkeypatch, cause, error):
    monkeypatch.setattr(ports_module.sys, "platform", "linux")
    assert type(ports_module.explain_open_error("/dev/ttyTEST", cause)) is error
