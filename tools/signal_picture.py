"""Draw one run of `align --signal` on the virtual table, docs/images/signal.png: python tools/signal_picture.py

Above the light in the fibre, below the ways of the axes by the drive of their motors. Needs matplotlib.
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot as plt

sys.path.insert(0, str(Path(__file__).resolve().parent / "bench"))
from couple import opened

from mirrormount_beam.control.events import Event, Pulsed, SignalRead
from mirrormount_beam.control.maximise import maximise

IMAGE = Path(__file__).resolve().parent.parent / "docs" / "images" / "signal.png"
SEED = 1


def main() -> None:
    """Run and draw."""
    light: list[tuple[float, float]] = []
    with opened(SEED, 2, "hardware") as (table, read, _):
        ways = {actuator.name: [(table.now_s(), 0.0)] for actuator in table.actuators}
        steps = {actuator.name: actuator.step_us for actuator in table.actuators}

        def listen(event: Event) -> None:
            if isinstance(event, SignalRead):
                light.append((event.time_s, event.value))
            elif isinstance(event, Pulsed):
                before = ways[event.actuator][-1][1]
                ways[event.actuator].append((event.time_s, before + event.us / steps[event.actuator]))

        maximise(table, read, listen)
    figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(8, 5.5), layout="constrained")
    above.semilogy(*zip(*light, strict=True), lw=0.8, color="#1f5fa8")
    above.set_ylabel("light in the fibre, of all")
    above.set_ylim(3e-3, 1.3)
    above.grid(alpha=0.3)
    for name, way in ways.items():
        below.step(*zip(*way, strict=True), where="post", lw=1.0, label=name)
    below.set_ylabel("net drive, steps")
    below.set_xlabel("time of the mounts, s (simulated)")
    figure.legend(ncols=4, fontsize="small", loc="outside lower center")
    below.grid(alpha=0.3)
    figure.savefig(IMAGE, dpi=110)


if __name__ == "__main__":
    main()
