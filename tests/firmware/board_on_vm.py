"""A board in one process, on any MicroPython: main.py with the fakes, and a host that follows a script.

usage: board_on_vm.py FAKES_DIR ROOT_DIR [deploy's part, a Python file]

ROOT_DIR is the board's file system, with the firmware on it. Prints one line of JSON: what the board sent after each
part of the session, its pin edges, and what is left. Where the VM has no emitter of native code, the caller has taken
the decorators out of the sources, and ptr8 and ptr32, which native code alone knows, stand here for themselves.
"""

import builtins
import json
import os
import sys

FAKES, ROOT = sys.argv[1], sys.argv[2]
START_US = (1 << 30) - 500_000  # the firmware's clock wraps early in the session
WASI_ENOENT = 44
MACHINE = "Raspberry Pi Pico with RP2040"

# (microseconds to wait first, bytes to send then). What is sent until the next one is kept under the bytes.
FIRST = (
    (1_500_000, b"*IDN?\n"),
    (100_000, b"XF?\n"),
    (100_000, b"1XP100000;2XP100000;1XP?\n"),
    (100_000, b"1PR1;2PR-1\n"),
    (500_000, b"02550255"),
    (60_000, b"!\n"),
    (100_000, b"01280128"),
    (60_000, b"00000000"),
    (100_000, b"XS?\n"),
    (100_000, b"1XV70;SM\n"),
    (500_000, b"TE?\n"),
    (100_000, b"nonsense\n"),
    (100_000, b"TB?\n"),
    (100_000, b"1MV+\n"),
    (60_000, b"\x03"),
)
SECOND = ((1_500_000, b"1XV?\n"), (100_000, b"\x03"))  # after a restart


class Stand:
    """A stand-in for a module: what it has, and some of our own."""

    def __init__(self, module, changes):
        for name in dir(module):
            if not name.startswith("__"):
                setattr(self, name, getattr(module, name))
        for name, value in changes.items():
            setattr(self, name, value)


class Implementation:
    """sys.implementation of a Pico."""

    name = "micropython"
    _machine = MACHINE


show = print


def use_fakes():
    """Put the fakes before the VM's own modules, and the board's streams into sys. Returns the fake seam's module."""
    import micropython

    sys.path[:] = [FAKES]
    import _seam

    changes = {"kbd_intr": lambda char: setattr(_seam.seam, "interrupt_char", char), "const": lambda x: x}
    sys.modules["micropython"] = Stand(micropython, changes)
    _seam.seam = _seam.Seam(None, None, START_US)
    for name in ("machine", "select", "time"):
        sys.modules.pop(name, None)
        __import__(name)
    import _console

    out = _console.stdout
    streams = {"stdin": _console.stdin, "stdout": out, "implementation": Implementation}
    sys.modules["sys"] = Stand(sys, streams)
    if not hasattr(os, "urandom"):
        use_files_of_a_board()
    if not hasattr(builtins, "ptr8"):
        builtins.ptr8 = builtins.ptr32 = lambda buffer: buffer
    builtins.print = lambda *values, sep=" ", end="\n": out.write(sep.join([str(v) for v in values]) + end)
    os.chdir(ROOT)
    sys.path[:] = [""]
    return _seam


def use_files_of_a_board():
    """What a board has and a WebAssembly build has not: os.urandom, and the number 2 for "no such file"."""

    def as_on_a_board(function):
        def call(*arguments):
            try:
                return function(*arguments)
            except OSError as e:
                raise OSError(2 if e.errno == WASI_ENOENT else e.errno)  # noqa: B904

        return call

    changes = {name: as_on_a_board(getattr(os, name)) for name in ("stat", "remove", "rename", "listdir", "mkdir")}
    changes["urandom"] = bytes
    sys.modules["os"] = Stand(os, changes)
    builtins.open = as_on_a_board(builtins.open)


def seam_class(_seam):
    """The fakes' seam, with the script in the place of the simulation."""

    class Seam(_seam.Seam):
        def __init__(self, script, t0):
            super().__init__(None, None, t0)
            self.script = list(script)
            self.said = {}
            self.edges = []
            self._now = "start"
            self._at = t0 + self.script[0][0]
            self._grant = self._at

        def wait(self, until):
            if self.latched:
                until = min(until, self.latched[0][0])
            if self.script and until >= self._at:
                self.t = max(self.t, self._at)
                self._next()
            else:
                self.t = max(self.t, until)
            self._show_latched()
            if self._interrupted:
                self._interrupted = False
                raise KeyboardInterrupt

        def _next(self):
            locks = self._unlock()
            data = self.script.pop(0)[1]
            self._now = data.decode().strip()
            for c in data:
                if c == self.interrupt_char:
                    self._interrupted = True
                else:
                    self._rx[self._head] = c
                    self._head = (self._head + 1) % len(self._rx)
            self._at = self.t + (self.script[0][0] if self.script else 1 << 40)
            self._grant = self._at
            self._lock(locks)

        def edge(self, pin, duty, _hz=0):
            locks = self._unlock()
            self.edges.append((self.t - START_US, pin, duty))
            self._lock(locks)

        def sent(self, c):
            locks = self._unlock()
            self.said[self._now] = self.said.get(self._now, "") + chr(c)
            self._lock(locks)

    return Seam


def start(_seam, script, t0):
    """One life of the board, from power-up to its prompt. Returns its seam."""
    for name in list(sys.modules):
        if name.startswith("mountfw"):
            del sys.modules[name]
    seam = _seam.seam = seam_class(_seam)(script, t0)
    with open("main.py") as f:
        source = f.read()
    exec(compile(source, "main.py", "exec"), {"__name__": "__main__"})
    return seam


_seam = use_fakes()
first = start(_seam, FIRST, START_US)
second = start(_seam, SECOND, first.t)
found = []
if len(sys.argv) > 3:
    with open(sys.argv[3]) as f:
        source = f.read()
    board_side = {"__name__": "__main__"}
    exec(compile(source, "board_side", "exec"), board_side)
    board_side["room"] = lambda: (0, 1)  # a file system in memory does not count
    board_side["say"] = lambda *fact: found.append(fact)
    board_side["survey"]()
builtins.print = show
print(json.dumps({"first": first.said, "second": second.said, "edges": first.edges, "survey": found}))
