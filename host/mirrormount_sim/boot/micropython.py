"""Boots a board on a MicroPython VM (Unix port): a child process of Simulation, never imported by the host.

usage: micropython -X heapsize=192k micropython.py FAKES_DIR ROOT_DIR MACHINE_NAME START_US READ_FD WRITE_FD

ROOT_DIR becomes the board's file system. As on a board: boot.py and main.py run, then there is a prompt,
friendly or raw (with raw paste), which real mpremote works with; Ctrl-D is a soft reset. The one thing
that a board can and this cannot: interrupt code that never looks at a clock, a pin or its input. What of the
host can be reached from here: fakes/_fence.py.
"""

import sys

FAKES, ROOT, MACHINE_NAME = sys.argv[1], sys.argv[2], sys.argv[3]
START_US, READ_FD, WRITE_FD = int(sys.argv[4]), int(sys.argv[5]), int(sys.argv[6])

CTRL_A, CTRL_B, CTRL_C, CTRL_D, CTRL_E = 1, 2, 3, 4, 5
_RAW_BANNER = b"raw REPL; CTRL-B to exit\r\n>"
_PASTE_WINDOW = 128


class _SoftReset(Exception):
    """SystemExit as on a board."""


class _Implementation:
    """sys.implementation of the board that this stands for."""

    name = sys.implementation.name
    version = sys.implementation.version
    _machine = MACHINE_NAME
    _mpy = sys.implementation._mpy


def _install():
    """Fake hardware, console and file system. Returns (seam, stdin.readinto, stdout.write)."""
    sys.path[:] = [FAKES]
    import _seam
    import micropython
    from _fence import Delegate, install

    seam = _seam.seam = _seam.Seam(open(READ_FD, "rb"), open(WRITE_FD, "wb"), START_US)

    def kbd_intr(char):
        seam.interrupt_char = char

    def heap_lock():
        seam.locks += 1
        return micropython.heap_lock()

    def heap_unlock():
        seam.locks -= 1
        return micropython.heap_unlock()

    changes = {"kbd_intr": kbd_intr, "heap_lock": heap_lock, "heap_unlock": heap_unlock, "const": lambda x: x}
    sys.modules["micropython"] = Delegate(micropython, (), changes)

    import _console

    for name in ("machine", "rp2", "select", "time"):  # now, while FAKES can be reached
        __import__(name)

    out = _console.stdout

    def say(*values, sep=" ", end="\n", file=None):  # the VM's own goes to the process's stdout
        (file or out).write(sep.join([str(v) for v in values]) + end)

    streams = {"stdin": _console.stdin, "stdout": out, "stderr": out, "implementation": _Implementation}
    install(ROOT, {"builtins": {"print": say}, "sys": streams})
    sys.path[:] = ["", "/lib"]
    return seam, _console.stdin.buffer.readinto, out.buffer.write


seam, readinto, write = _install()
del sys  # the VM's: what is imported from here on is what a board has

import gc  # noqa: E402
import io  # noqa: E402
import sys  # noqa: E402

_kept = set(sys.modules)
_byte = bytearray(1)
_globals = {"__name__": "__main__"}
gc.threshold(32 * 1024)  # a VM keeps its names where they were put: collect early, so that the heap stays in one piece


def _soft_reset():
    write(b"MPY: soft reboot\r\n")
    for name in list(sys.modules):
        if name not in _kept:
            del sys.modules[name]
    seam.handlers.clear()
    seam.counters.clear()
    _globals.clear()
    _globals["__name__"] = "__main__"
    seam.interrupt_char = CTRL_C
    gc.collect()


def _get():
    """The next byte from the console; a Ctrl-C is one, too."""
    while True:
        try:
            readinto(_byte)
            return _byte[0]
        except KeyboardInterrupt:
            return CTRL_C


def _run(source, name, kind):
    """Run source. Returns the exception that ended it, or None. `eval` shows the value of an expression."""
    try:
        seam.interrupt_char = CTRL_C
        if kind == "eval":
            try:
                code = compile(source, name, "eval")
            except SyntaxError:
                exec(compile(source, name, "exec"), _globals)
                return None
            value = eval(code, _globals)
            if value is not None:
                print(repr(value))
        else:
            exec(compile(source, name, kind), _globals)
    except SystemExit:
        if seam._off:  # the simulation is gone
            raise
        raise _SoftReset() from None
    except BaseException as e:
        return e
    return None


def _show(error):
    if error:
        text = io.StringIO()
        sys.print_exception(error, text)
        print(text.getvalue(), end="")


def _run_file(name):
    try:
        with open(name) as f:
            source = f.read()
    except OSError:
        return
    _show(_run(source, name, "exec"))


def _receive_pasted():
    """Raw paste: the source, or None if it was broken off."""
    write(b"R\x01" + _PASTE_WINDOW.to_bytes(2, "little") + b"\x01")
    source = bytearray()
    while True:
        c = _get()
        if c == CTRL_D:
            write(b"\x04")
            return source
        if c == CTRL_C:
            write(b"\x04")
            return None
        source.append(c)
        if len(source) % _PASTE_WINDOW == 0:
            write(b"\x01")


def _raw():
    """The raw prompt. True: soft reset. False: back to the friendly one."""
    write(_RAW_BANNER)
    source = bytearray()
    while True:
        c = _get()
        if c == CTRL_A:
            write(_RAW_BANNER)
            source = bytearray()
        elif c == CTRL_B:
            write(b"\r\n")
            return False
        elif c == CTRL_C:
            source = bytearray()
        elif c == CTRL_E and not source:
            if _get() == 0x41 and _get() == CTRL_A:
                pasted = _receive_pasted()
                _answer(pasted)
            else:
                write(b"R\x00")
        elif c == CTRL_D:
            write(b"OK")
            if not source:
                write(b"\r\n")
                return True
            _answer(source)
            source = bytearray()
        else:
            source.append(c)


def _answer(source):
    error = _run(str(source, "utf-8"), "<stdin>", "exec") if source else None
    write(b"\x04")
    _show(error)
    write(b"\x04>")


def _friendly():
    """The friendly prompt, a line at a time. True: the raw prompt is wanted. False: soft reset."""
    write(b"MicroPython (virtual board); %s\r\n>>> " % MACHINE_NAME.encode())
    line = bytearray()
    while True:
        c = _get()
        if c == CTRL_A:
            return True
        if c == CTRL_D and not line:
            write(b"\r\n")
            return False
        if c == CTRL_B or c == CTRL_C:
            write(b"\r\n>>> ")
            line = bytearray()
        elif c == 13 or c == 10:
            write(b"\r\n")
            if line.strip():
                _show(_run(str(line, "utf-8"), "<stdin>", "eval"))
            write(b">>> ")
            line = bytearray()
        elif c >= 32:
            line.append(c)
            write(bytes([c]))


def _prompt(raw):
    """Serve the prompt until a soft reset. True if it was requested at the raw prompt."""
    while True:
        if raw and _raw():
            return True
        raw = _friendly()
        if not raw:
            return False


raw = False
while True:
    try:
        _run_file("boot.py")
        if not raw:
            _run_file("main.py")
        raw = _prompt(raw)
    except _SoftReset:
        raw = False
    _soft_reset()
