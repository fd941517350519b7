"""Boots the CircuitPython port on fakes, on CPython or on a MicroPython VM: a child process of Simulation.

usage: … circuitpython.py FAKES_DIR FIRMWARE_DIR FILES_DIR LIB_DIR BOARD_ID START_US READ_FD WRITE_FD

This is no CircuitPython: the modules that only CircuitPython has are fakes_circuitpython. As on a board, boot.py
runs once, then code.py, each with what it imported forgotten and its pins given back. A boot.py or code.py in
FILES_DIR, the board's drive, goes before the firmware's. Where the protocol has the console, 0x03 ends code.py and
there is as much of a prompt as a host needs to tell where it is; otherwise nobody can reach the console.
"""

import builtins
import gc
import os
import sys

FAKES, FIRMWARE, FILES, LIB, BOARD_ID = sys.argv[1:6]
START_US, READ_FD, WRITE_FD = int(sys.argv[6]), int(sys.argv[7]), int(sys.argv[8])
ON_CPYTHON = sys.implementation.name == "cpython"
MODULES = (
    "analogio board busio digitalio microcontroller pwmio rotaryio select storage supervisor time usb_cdc watchdog"
)


class _Exactly:
    """readinto() that fills the buffer; 0 at the end."""

    def __init__(self, stream):
        self.readinto = stream.readinto


class _Delegate:
    """A stand-in for a module that cannot be shadowed by a path: its attributes, and some of our own."""

    def __init__(self, module, changes):
        for name in dir(module):
            if not name.startswith("__"):
                setattr(self, name, getattr(module, name))
        for name in changes:
            setattr(self, name, changes[name])


class _Implementation:
    """sys.implementation, as CircuitPython calls itself."""

    name = "circuitpython"
    version = (10, 0, 0)
    _machine = BOARD_ID


class _Hashlib:
    """hashlib as CircuitPython has it: new(), and nothing else."""

    def __init__(self, module):
        self._sha256 = module.sha256

    def new(self, name):
        if name != "sha256":
            raise ValueError("Unsupported hash algorithm")
        return self._sha256()


def _prepare_cpython():
    """Sets up the fakes under CPython. Returns both ends of the seam."""
    import signal
    import types

    if hasattr(signal, "SIGINT"):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal is the host's
    for module in (types, __import__("enum"), __import__("tokenize"), __import__("linecache")):
        assert module  # imported while time is still the real one
    stub = types.ModuleType("micropython")
    stub.heap_lock = stub.heap_unlock = lambda: 0  # for the seam
    sys.modules["micropython"] = stub
    gc.mem_free = lambda: 0  # CPython has no such number
    os.rename = os.replace
    os.sync = _nothing  # the system's own would wait for every disk
    rd = sys.stdin.buffer
    wr = open(os.dup(1), "wb", buffering=0)
    return _Exactly(rd), wr


def _nothing():
    pass


def _prepare_vm():
    import hashlib

    sys.modules["hashlib"] = _Hashlib(hashlib)
    sys.modules["os"] = _Delegate(os, {"sync": _nothing})
    return open(READ_FD, "rb"), open(WRITE_FD, "wb")


def _install():
    """Fake hardware where the firmware will import it from. Returns the seam's module."""
    rd, wr = _prepare_cpython() if ON_CPYTHON else _prepare_vm()
    own = list(sys.path) if ON_CPYTHON else []
    sys.path[:] = [FAKES + "_circuitpython", FAKES] + own
    try:
        os.chdir(FILES)
    except OSError:  # Ctrl-C has ended the host meanwhile, and its folder went
        sys.exit(1)
    import _seam

    _seam.seam = _seam.Seam(rd, wr, START_US)
    for name in MODULES.split():
        sys.modules.pop(name, None)  # time is built in: no path can shadow it once it is there
        if ON_CPYTHON:
            _load_fake(name)
        else:
            __import__(name)
    __import__("_console")  # while FAKES can be reached
    sys.path[:] = [FIRMWARE] + own + ([LIB] if LIB else [])
    return _seam


def _load_fake(name):
    import importlib.util

    file = FAKES + "_circuitpython/" + name + ".py"
    spec = importlib.util.spec_from_file_location(name, file)
    sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])


_seam = _install()
import _chip  # noqa: E402
import _console  # noqa: E402
import board  # noqa: E402
import microcontroller  # noqa: E402
import usb_cdc  # noqa: E402

board.board_id = BOARD_ID
_kept = None


def _say(text):
    """Output of print(): to the console, which the host may read."""
    if not _chip.in_boot_py and usb_cdc.data is None:
        _console.stdout.write(text)


def _print(*values, sep=" ", end="\n", file=None):
    _say(sep.join([str(v) for v in values]) + end)


def _run(name):
    """One of the board's files, in a memory of its own."""
    for path in (FILES + "/" + name, FIRMWARE + "/mountfw/entry/" + name):
        try:
            with open(path) as f:
                source = f.read()
        except OSError:
            continue
        try:
            exec(compile(source, name, "exec"), {"__name__": "__main__", "print": _print})
        except KeyboardInterrupt:
            _say("KeyboardInterrupt:\n")
        except Exception as e:
            _say("%s: %s\n" % (type(e).__name__, e))
            sys.stderr.write("%s: %s: %s\n" % (name, type(e).__name__, e))
        finally:
            _chip.reset()
            for module in list(sys.modules):
                if module not in _kept:
                    del sys.modules[module]
        return


def _prompt(on_console):
    """Wait for Ctrl-D on the console; for ever if no host reads the console."""
    _seam.seam.interrupt_char = -1
    _say("\nAdafruit CircuitPython (virtual board); %s\n>>> " % BOARD_ID)
    line = ""
    while True:
        c = chr(_seam.seam.take())
        if not on_console:
            continue
        if c == "\x04" and not line:
            _say("\nsoft reboot\n")
            return
        if c in "\r\n":
            known = line.strip() == "import mountfw"
            _say("\n" + ("" if known or not line.strip() else "SyntaxError: invalid syntax\n") + ">>> ")
            line = ""
        elif c == "\x03":
            line = ""
            _say("\n>>> ")
        else:
            line += c
            _say(c)


def _boot():
    global _kept
    _chip.in_boot_py = True
    usb_cdc.console, usb_cdc.data = usb_cdc.Serial(), None
    _kept = _kept or set(sys.modules)
    _seam.seam.interrupt_char = -1
    _run("boot.py")
    on_console = usb_cdc.plug_in()
    _chip.in_boot_py = False
    while True:
        _seam.seam.interrupt_char = 3 if on_console else -1
        _run("code.py")
        _prompt(on_console)


builtins.print = _print
if ON_CPYTHON:
    sys.implementation.name = "circuitpython"
else:
    sys.modules["sys"] = _Delegate(sys, {"implementation": _Implementation})
while True:
    try:
        _boot()
    except microcontroller.HardReset:
        _seam.seam.forget()
        _chip.reset()
