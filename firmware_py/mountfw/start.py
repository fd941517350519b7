"""What main.py starts on MicroPython: motors off, the firmware, motors off whatever happened.

It is imported, not called: main.py knows no more of a firmware than the name of this module.
"""

from mountfw.ports import micropython as port

board = port.find_board()
if board:
    try:
        try:
            port.motors_off(board)
            port.collect()  # twice: else what imports leave lies between what stays, and a Pico W has no 4 KB left
            from mountfw.build import build

            port.collect()
            app = build(port, board)
            build = None  # pyright: ignore  # `del` alone would keep what it is
            app.run()
        finally:
            port.leave(board)
    except KeyboardInterrupt:
        pass
    finally:
        port.leave(board)  # again: a second Ctrl-C may have kept the first one from starting
    print("mountfw has stopped, motors are off. Ctrl-D starts it again.")
