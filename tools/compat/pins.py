"""What the motors did, read off the pin edges that a virtual board has written down. No I/O."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

_TWO_AXES = (1, 2)


@dataclass(frozen=True)
class Drive:
    """One stretch of drive: axis, sign (+1 or -1: which leg was high), start, length; None: it still has drive."""

    axis: int
    sign: int
    start_us: int
    length_us: int | None = None

    @property
    def ms(self) -> int:
        """Its length in whole milliseconds, with the sign. Raises ValueError if it still lasts."""
        if self.length_us is None:
            raise ValueError(f"axis {self.axis} still has drive")
        return self.sign * round(self.length_us / 1000)


def drives(edges: Iterable[dict]) -> list[Drive]:
    """The stretches of drive of both axes, in the order of their beginnings.

    edges: the objects that `mirrormount virtual --edges` writes, of a bridge with an enable and two legs. Raises
    ValueError for an enable that goes high while not exactly one leg is.
    """
    found: list[Drive] = []
    level = {f"m{axis}_{leg}": 0 for axis in _TWO_AXES for leg in ("en", "pos", "neg")}
    for edge in edges:
        pin, now = edge["pin"], int(edge["duty" if "duty" in edge else "level"] > 0)
        was, level[pin] = level[pin], now
        if not pin.endswith("_en") or now == was:
            continue
        axis = int(pin[1])
        if now:
            sign = level[f"m{axis}_pos"] - level[f"m{axis}_neg"]
            if not sign:
                raise ValueError(f"at {edge['t_us']} us axis {axis} has drive, and its legs are alike")
            found.append(Drive(axis, sign, edge["t_us"]))
        else:
            last = max(i for i, drive in enumerate(found) if drive.axis == axis)
            found[last] = replace(found[last], length_us=edge["t_us"] - found[last].start_us)
    return found


def told(found: Iterable[Drive]) -> str:
    """The same in words: "axis 1: 3 x +20 ms, 1 x -7 ms; axis 2: nothing"."""
    text = []
    for axis in _TWO_AXES:
        runs: list[tuple[str, int]] = []
        for drive in found:
            if drive.axis == axis:
                word = f"{drive.ms:+d} ms" if drive.length_us is not None else "still drives"
                n = runs.pop()[1] if runs and runs[-1][0] == word else 0
                runs.append((word, n + 1))
        text.append(f"axis {axis}: " + (", ".join(f"{n} x {word}" for word, n in runs) or "nothing"))
    return "; ".join(text)
