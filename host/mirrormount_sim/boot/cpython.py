"""Boots the firmware on CPython: a child process of Simulation, never imported by the host.

usage: python -I -S cpython.py FIRMWARE_DIR FILES_DIR MACHINE_NAME START_US UNIT

The seam is this process's stdin and stdout. After Ctrl-C, or when the firmware has ended, there is
as much of a prompt as a host needs to tell where it is: `>>> `, and Ctrl-D to start again.
FIRMWARE_DIR is the folder that holds `mountfw`; one without it makes a board without firmware. FILES_DIR is
where the board keeps what it saves. UNIT makes its unique id: boards of one table have different ones.
"""

import builtins
import contextlib
import gc
import importlib.util
import os
import signal
import sys
import types

FIRMWARE_DIR, FILES_DIR, MACHINE_NAME = sys.argv[1:4]
START_US, UNIT = int(sys.argv[4]), int(sys.argv[5])
FAKES = os.path.join(os.path.dirname(os.path.dirname(os.path.abspath(__file__))), "fakes")


class _Exactly:
    """readinto() that fills the buffer; 0 at the end."""

    def __init__(self, stream):
        self.readinto = stream.readinto  # a buffered reader's fills it unless the stream ends


def _boot_id_of_nine_digits(count, random=os.urandom):
    """Random bytes. A boot id of them takes as long to send at every start, so that runs of a seed repeat exactly."""
    while True:
        data = random(count)
        if count != 4 or 10**8 <= int.from_bytes(data, "little") & 0x3FFFFFFF < 10**9:
            return data


def _install():
    """Put the fake hardware where the firmware will import it from. Returns the seam module."""
    if hasattr(signal, "SIGINT"):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal is the host's
    mp = types.ModuleType("micropython")
    mp.const = mp.native = mp.viper = lambda x: x
    builtins.ptr8 = builtins.ptr32 = lambda buffer: buffer  # viper's view of a buffer
    mp.heap_lock = mp.heap_unlock = lambda: 0
    sys.modules["micropython"] = mp
    gc.mem_free = lambda: 0  # CPython has no such number
    sys.path[:0] = [FAKES, os.path.abspath(FIRMWARE_DIR)]
    try:
        os.chdir(FILES_DIR)
    except FileNotFoundError:  # Ctrl-C has ended the host meanwhile, and its folder went
        sys.exit(1)
    os.urandom = _boot_id_of_nine_digits
    os.rename = os.replace  # a board's renames onto a file that is there, Windows's does not
    import _seam

    rd, wr = sys.stdin.buffer, open(os.dup(1), "wb", buffering=0)  # noqa: SIM115 (lives as long as the process)
    _seam.seam = _seam.Seam(_Exactly(rd), wr, START_US)
    mp.kbd_intr = lambda c: setattr(_seam.seam, "interrupt_char", c)
    for name in ("time", "select", "machine"):  # time is built in: no path can shadow it
        spec = importlib.util.spec_from_file_location(name, os.path.join(FAKES, name + ".py"))
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    machine = sys.modules["machine"]
    first = machine.unique_id()
    machine.unique_id = lambda: first[:-1] + bytes((first[-1] + UNIT & 255,))
    import _console

    sys.stdin, sys.stdout = _console.stdin, _console.stdout
    sys.implementation._machine = MACHINE_NAME
    return _seam


def _run_main():
    path = os.path.join(FIRMWARE_DIR, "mountfw", "entry", "main.py")
    for name in [n for n in sys.modules if n.split(".")[0] == "mountfw"]:
        del sys.modules[name]
    if os.path.exists(path):
        with open(path, encoding="utf-8") as f:
            code = compile(f.read(), "main.py", "exec")
        exec(code, {"__name__": "__main__"})


def _prompt():
    """Until Ctrl-D: echo, and know nothing but `import mountfw`."""
    line = ""
    print(f"MicroPython (virtual board); {MACHINE_NAME}\n>>> ", end="")
    while True:
        try:
            c = chr(_console_in())
            if c == "\x04" and not line:
                print("\nMPY: soft reboot")
                return
            if c == "\x03":
                line = ""
                print("\n>>> ", end="")
            elif c in "\r\n":
                print("\n" + _say(line.strip()) + ">>> ", end="")
                line = ""
            elif c.isprintable():
                line += c
                print(c, end="")
        except KeyboardInterrupt:
            line = ""
            print("\n>>> ", end="")


def _say(line):
    if line == "import mountfw":
        found = os.path.isdir(os.path.join(FIRMWARE_DIR, "mountfw"))
        return "" if found else "ImportError: no module named 'mountfw'\n"
    return "SyntaxError: invalid syntax\n" if line else ""


def _console_in():
    byte = bytearray(1)
    sys.stdin.buffer.readinto(byte)
    return byte[0]


_seam = _install()
while True:
    with contextlib.suppress(KeyboardInterrupt):
        _run_main()
    _prompt()
    _seam.seam.handlers.clear()
    _seam.seam.counters.clear()
