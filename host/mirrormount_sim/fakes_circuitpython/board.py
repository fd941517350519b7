"""board on the virtual CircuitPython board: the names of a Pico's pins. boot/circuitpython.py sets board_id."""

import _chip

board_id = "raspberry_pi_pico"
LED = _chip.gpio[25]
