"""What CircuitPython runs after boot.py and after each Ctrl-D: motors off, the firmware, motors off again."""

import supervisor

supervisor.runtime.autoreload = False  # before anything else: a file that is saved must not cut a move off

from mountfw.ports import circuitpython as port  # noqa: E402

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
