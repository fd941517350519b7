"""What MicroPython runs at power-up: motors off, the firmware, motors off whatever happened."""

import os
import sys


def replay():
    """Finish what `mirrormount deploy` has committed. True if there was anything.

    Each line of the journal renames a file or removes one. The power may go after any of them, so
    the next boot begins anew and finds the first ones done. No failure but that one is hidden.
    """
    try:
        with open("mountfw.journal") as f:
            lines = f.read().split()
    except OSError:
        return False
    for line in lines:
        old, _, new = line.partition(">")
        try:
            if new:
                os.rename(old, new)
            else:
                os.remove(old)
        except OSError as e:
            if e.errno != 2:  # ENOENT: done already
                raise
    os.remove("mountfw.journal")
    return True


if replay():
    raise SystemExit  # a soft reset: this very file may be a new one now

sys.path.insert(0, "mountfw/ports")
try:
    import rp2_listed as listed  # pyright: ignore[reportMissingImports]  # so no folder on the way is looked at: 20 ms
except ImportError:  # the program was not started where the folder is
    from mountfw.ports import rp2_listed as listed
finally:
    sys.path.pop(0)

try:
    try:
        listed.enter()
        from mountfw.ports import micropython as port

        board = port.find_board()
        if board:
            port.motors_off(board)
        from mountfw.build import build
        from mountfw.memory import forget_start
    finally:
        listed.leave()
finally:
    listed.leave()  # again: a second Ctrl-C may have kept the first one from starting
if board:
    try:
        try:
            app = build(port, board)
            forget_start()
            build = listed = replay = forget_start = None  # pyright: ignore  # `del` alone would keep what they are
            app.run()
        finally:
            port.leave(board)
    except KeyboardInterrupt:
        pass
    finally:
        port.leave(board)  # again, likewise
    print("mountfw has stopped, motors are off. Ctrl-D starts it again.")
