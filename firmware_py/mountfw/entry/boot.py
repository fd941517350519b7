"""What CircuitPython runs once at power-up, before USB is there: motors off, and a USB channel for the protocol.

The pins float again when this file ends, until code.py has them: the pull-downs of docs/bring-up.md hold them.
"""

import supervisor
import usb_cdc

from mountfw.ports import circuitpython as port

supervisor.runtime.autoreload = False  # a file that is saved must not cut a move off
board = port.find_board()
if board:
    port.motors_off(board)
one_channel = getattr(board, "ONE_CHANNEL", False)  # of a board with too few endpoints: two would end in safe mode
usb_cdc.enable(console=True, data=board is not None and not one_channel)
supervisor.status_bar.console = not one_channel  # what it writes would be in the middle of our answers
