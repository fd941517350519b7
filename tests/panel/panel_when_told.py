"""`mirrormount panel` that has made its imports before its board is there: a line on stdin lets it begin."""

import sys

import mirrormount.cli.panel_opening
import mirrormount.panel.server  # noqa: F401, with NiceGUI: most of the time that a start takes
from mirrormount.cli.main import main

if __name__ == "__main__":
    sys.stdin.readline()
    sys.exit(main(["panel", *sys.argv[1:]]))
