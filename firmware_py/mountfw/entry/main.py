"""What MicroPython runs at power-up: the firmware in the folder mountfw.

`mirrormount deploy` replaces the firmware by two renames: mountfw to mountfw.old, mountfw.new to mountfw. If the power
went between them, this file does the second one. It knows nothing else of the firmware but mountfw/start.py, so it
starts the old one and the new one alike.
"""

try:
    import mountfw
except ImportError:  # there is no such folder
    import os

    os.rename("mountfw.new", "mountfw")

import mountfw.start  # noqa: F401
