"""rig.py is imported by its bare name, as on the MicroPython VM."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
