"""What MicroPython runs at power-up: motors off, the firmware, motors off whatever happened."""

from mountfw import port_micropython as port

board = port.find_board()
if board:
    try:
        try:
            port.motors_off(board)
            from mountfw.app import build

            build(port, board).run()
        finally:
            port.leave(board)
    except KeyboardInterrupt:
        pass
    finally:
        port.leave(board)  # again: a second Ctrl-C may have kept the first one from starting
    print("mountfw has stopped, motors are off. Ctrl-D starts it again.")
