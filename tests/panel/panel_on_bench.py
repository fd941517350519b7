"""`mirrormount panel --virtual …` whose bench takes orders. A line of stdin is one; each prints one line.

unplug, plug: the camera; hand MOTOR, jam MOTOR: at a motor of the mount; duties: prints those of both enables.
--patience may be longer than a person's: a page on a busy computer is silent for seconds.
"""

import json
import sys
import threading

from mirrormount.cli import arguments, main
from mirrormount_sim import table
from mirrormount_sim.bench import Order

tables = []


class Watched(table.VirtualTable):
    """A table that is known here."""

    def __init__(self, *args) -> None:
        super().__init__(*args)
        tables.append(self)


def act() -> None:
    """Carry out the lines of stdin."""
    faults = {"hand": "hand", "jam": "jammed"}
    for line in sys.stdin:
        word, *motor = line.split()
        bench = tables[0].simulations[0].bench
        told: object = "done"
        if word in ("plug", "unplug"):
            for camera in tables[0].cameras:
                camera.plugged = word == "plug"
        elif word == "duties":
            told = {name: duty for name, duty in bench.duties().items() if name.endswith("_en")}
        else:
            bench._orders.append(Order(faults[word], motor[0]))  # the bench's own thread takes it
        print(json.dumps(told), flush=True)


if __name__ == "__main__":
    table.VirtualTable = Watched
    arguments.MOST_PATIENCE_S = 60
    threading.Thread(target=act, daemon=True).start()
    sys.exit(main.main(["panel", *sys.argv[1:]]))
