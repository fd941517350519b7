"""Commands of axis 1 as bytes, why they may end a move, and switches that follow its pins; for axis_session.py."""

from axis_gap import Unclear
from axis_model import AxisModel
from axis_move import END_STOP, HOMING_FAILED, RUN_LIMIT, SOFT_LIMIT, STOPPED, SUPERSEDED
from rig import Rig

MOTIONS = ("PR", "PA", "XU", "MV", "MT", "OR", "frame")
STOPS = {"!": 3, "AB": 3, "ST": STOPPED, "1ST": STOPPED, "00000000": STOPPED}
AT_REST = ("XP", "XI", "DH", "ZH")  # refused with n14 while it moves
ERRORS_OF = {END_STOP: (104, 105), SOFT_LIMIT: (106, 107), RUN_LIMIT: (140,), HOMING_FAILED: (145, 146, 104, 105)}


class Switches(dict):
    """Axis 1's end-stops, which follow its pins to the microsecond. The rig asks get(pin, 1)."""

    def __init__(self, rig: Rig, ends: tuple[int, int]) -> None:
        self.rig, self.ends = rig, ends
        self.screw, self.seen, self.at = 0, len(rig.port.edges), rig.now()
        self.levels = {2: 0, 3: 0, 4: 0}

    def get(self, pin: int, _default: int = 1) -> int:
        edges = self.rig.port.edges
        for us, number, duty in edges[self.seen :]:
            self._go_on(us)
            self.levels[number] = duty
        self.seen = len(edges)
        self._go_on(self.rig.now())
        return int({10: self.screw >= self.ends[1], 11: self.screw <= self.ends[0]}.get(pin, False))

    def _go_on(self, us: int) -> None:
        duty = self.levels[2] // 257
        self.screw += (duty if self.levels[3] else -duty) * (us - self.at)
        self.at = us


def causes(model: AxisModel, name: str, value: int, stop: str) -> None:
    """Note why the move under way may end now."""
    m = model.move
    if not m:
        return
    if name == "frame":
        m.causes.add(SUPERSEDED)
        m.finishing = False
    for text in (name, stop):
        if text in ("ST", "1ST") and m.kind == "steps" and not model.duty and m.off_at is not None:
            due = m.off_at + m.period_us - m.length_us if m.pulse_at is None else m.pulse_at + m.period_us
            if -2_000 < due - model.now < 2_000:
                raise Unclear  # the next pulse may have begun before the stop came
        if text in ("ST", "1ST") and m.kind == "steps" and model.duty and not model.taking_up:
            left_us = model.nominal_us - (model.now - model.on_at)
            if abs(left_us - 250_000) < 2_000:
                raise Unclear
            m.finishing = left_us < 250_000
        elif text in STOPS:
            m.finishing = False
        if text in STOPS:
            m.causes.add(STOPS[text])


def text_of(name: str, value: int) -> bytes:
    """A command as it goes over the wire; a frame's other motor rests."""
    if name == "frame":
        return f"{value:04d}{0 if value else 77:04d}\n".encode()
    if name in STOPS:
        return name.encode() + b"\n"
    if name in ("MV", "MT"):
        return b"1%s%s\n" % (name.encode(), b"+" if value > 0 else b"-")
    if name == "OR":
        return b"1OR\n"
    return b"1%s%s\n" % (name.encode(), (str(value / 100) if name == "VA" else str(value)).encode())
