"""What MicroPython runs at power-up: motors off, the firmware, motors off whatever happened."""

import os


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

from mountfw.ports import micropython as port  # noqa: E402

board = port.find_board()
if board:
    try:
        try:
            port.motors_off(board)
            from mountfw.build import build

            app = build(port, board)
            app.run()
        finally:
            port.leave(board)
    except KeyboardInterrupt:
        pass
    finally:
        port.leave(board)  # again: a second Ctrl-C may have kept the first one from starting
    print("mountfw has stopped, motors are off. Ctrl-D starts it again.")
