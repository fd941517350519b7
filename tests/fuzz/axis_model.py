"""What one axis must be, worked out a second time: from the edges of its pins and from what was commanded.

The pins say which way (the legs), how hard (the enable's duty) and how long. A drive of a move by steps that is
as long as a pulse counts as one step exactly; every other drive counts as microseconds x duty, of which XP x XD is
a step. Written from docs/protocol.md, not from the firmware; imports nothing of it.

The firmware counts by its own clock, so it may differ from the pins by EDGE_US in each drive; where a stop has
cut it, which turns the pins off before it reads the clock, by CUT_US more; where a frame takes over by TAKEOVER_US.
These add up as `slack` until DH or homing says anew where the axis is.
"""

from axis_gap import Gap, Unclear
from axis_move import (
    ABORTED,
    DONE,
    END_STOP,
    ESTIMATED,
    HOMED,
    HOMING_FAILED,
    RUN_LIMIT,
    SOFT_LIMIT,
    STOPPED,
    SUPERSEDED,
    UNKNOWN,
    Move,
)

EDGE_US = 12
CUT_US = 40
TAKEOVER_US = 100
ENABLE, POS, NEG = 2, 3, 4  # axis 1 on the Pico
SHORTEST_US = 200  # less is not taken up
REST_US = 1_000
LATE_US = 4_000  # a switch that opens in a drive's last milliseconds is seen at its end


class AxisModel:
    """Fed with edges and ends in their order. Says where the axis is, or fails where it must not be."""

    def __init__(self, settings: dict[str, int], ends: tuple[int, int], now_us: int) -> None:
        self.settings = settings
        self.ends = ends  # where the switches open: microseconds of full drive x 255, as `screw`
        self.screw = 0
        self.position, self.slack = 0.0, 0.0  # steps
        self.certainty = {UNKNOWN}  # what it may be
        self.gap = Gap()
        self.step = settings["XP"] * settings["XD"]
        self.gap.size = settings["XB"] * settings["XD"]
        self.move: Move | None = None
        self.last = Move("none", 1, (), 0)
        self.reason = 0
        self.now = now_us
        self.levels = {ENABLE: 0, POS: 0, NEG: 0}
        self.way, self.duty = 0, 0  # of the drive that is on; the way is the motor's, own() makes it the axis's
        self.on_at = now_us
        self.nominal_us, self.tolerance_us = 0.0, 0.0  # of a pulse
        self.taking_up = False
        self._effect = 0.0  # of this drive on the mirror

    def own(self, way: int) -> int:
        """The motor's way as the axis's own, and back."""
        return -way if self.settings["XI"] else way

    def opened(self, way: int) -> bool:
        """Does the end-stop in the motor's direction forbid it?"""
        if self.settings["ZH"] & 1 or not self.settings["XL"] & (1 if way > 0 else 2):
            return False
        return self.screw >= self.ends[1] if way > 0 else self.screw <= self.ends[0]

    # ---- what the pins say

    def advance(self, us: int) -> None:
        """Time goes on, with the drive that is on."""
        if self.duty:
            assert self.move, "drives although nothing moves"
            amount = (us - self.now) * self.duty
            was_open = self.opened(self.way)
            self.screw += self.way * amount
            assert not was_open or amount < LATE_US * self.duty, "drove into an end-stop"
            self.move.on_us += us - self.now
            if self.move.kind != "steps":
                self._count(amount)
        self.now = us

    def edge(self, us: int, pin: int, duty: int) -> None:
        """A pin has changed."""
        if pin not in self.levels:
            return
        self.advance(us)
        self.levels[pin] = duty
        pos, neg = self.levels[POS] > 0, self.levels[NEG] > 0
        duty = self.levels[ENABLE] // 257
        assert not duty or pos != neg, "enabled with both legs alike"
        way = pos - neg if duty else 0
        if (way, duty) == (self.way, self.duty):
            return
        self.close()
        self.way, self.duty = way, duty
        if duty:
            assert not self.opened(way), "began to drive into an end-stop"
            self._open()

    def _open(self) -> None:
        m = self.move
        assert m, "drove although nothing moves"
        way = self.own(self.way)
        assert self.duty in m.duties, f"duty {self.duty} instead of {m.duties}"
        assert m.kind == "home" or way == m.way, "drove the wrong way"
        assert not (m.cut or m.finishing), "drove on after the end"
        self.on_at, self._effect = self.now, 0.0
        m.drives += 1
        if m.kind == "steps":
            self._open_pulse(m, way)

    def _open_pulse(self, m: Move, way: int) -> None:
        assert m.pulses < abs(m.n), "one pulse too many"
        assert m.off_at is None or self.now - m.off_at >= REST_US - EDGE_US, "no rest after a pulse"
        need_us, slack_us = self.gap.need(way) / self.duty, self.gap.slack / self.duty
        if abs(need_us - SHORTEST_US) <= slack_us + 2:
            raise Unclear
        self.taking_up = need_us >= SHORTEST_US
        self.nominal_us = need_us if self.taking_up else m.length_us
        self.tolerance_us = EDGE_US + (slack_us if self.taking_up else 0)
        if not self.taking_up:
            assert m.pulse_at is None or self.now - m.pulse_at >= m.period_us - EDGE_US, "pulses too close"
            m.pulse_at = self.now

    def close(self) -> None:
        """The drive is over, or another begins."""
        m = self.move
        if not self.duty:
            return
        assert m
        m.slack_us += EDGE_US
        m.off_at = self.now
        if m.kind == "steps":
            self._close_pulse(m)
        else:
            self.loosen(EDGE_US)

    def _close_pulse(self, m: Move) -> None:
        us = self.now - self.on_at
        way = self.own(self.way)
        what = "take-up" if self.taking_up else "pulse"
        assert us <= self.nominal_us + self.tolerance_us, f"{what} of {us} us instead of {self.nominal_us}"
        whole = us >= self.nominal_us - self.tolerance_us
        if not whole or self.opened(self.way):  # then the end-stop has ended it
            m.cut = True
            self._count(us * self.duty)
            self.loosen(EDGE_US)
        elif self.taking_up:
            self.gap.taken_up(way)
        else:
            worth = m.length_us * self.duty / self.step
            self.position += way * worth
            m.moved += way * worth
            m.pulses += 1
            if worth != 1:
                self.slack += 0.001  # it rounds to thousandths
                self.certainty = {c if c == UNKNOWN else ESTIMATED for c in self.certainty}
            self.gap.through(way, m.length_us * self.duty)

    def _count(self, amount: float) -> None:
        """Count a drive, or a part of one, by its time."""
        m, way = self.move, self.own(self.way)
        assert m
        effect = self.gap.through(way, amount)
        self._effect += effect
        self.position += way * effect / self.step
        m.moved += way * effect / self.step
        slack = self.gap.slack + EDGE_US * self.duty
        if self.certainty != {UNKNOWN} and (self._effect or self.gap.is_near(way, slack)):
            self.certainty = {ESTIMATED} if self._effect > slack else self.certainty | {ESTIMATED}

    def loosen(self, us: int) -> None:
        """The firmware may have counted so much more or less of the last drive."""
        amount = us * max(self.duty, self.levels[ENABLE] // 257, self._last_duty())
        if self._effect or self.gap.is_near(self.own(self.way), amount):
            self.slack += (amount + self.gap.slack) / self.step + 0.001  # and it rounds to thousandths
        self.gap.loosen(amount, self._effect)

    def _last_duty(self) -> int:
        return max(self.move.duties) if self.move else 0

    def position_slack(self) -> float:
        """In steps, with what the drive that is on may add."""
        return self.slack + (self.gap.slack + EDGE_US * self.duty) / self.step * bool(self.duty) + 0.0011

    # ---- moves

    def begin(self, move: Move) -> None:
        """A move is accepted."""
        assert not self.move, "accepted although it moves"
        self.move = move

    def take_over(self, us: int, move: Move, code: int) -> None:
        """A frame takes the drive over; it may go on without an edge."""
        self.advance(us)
        self.close()
        on, self.duty = self.duty, 0
        assert self.move
        self.move.causes.add(SUPERSEDED)
        self.end(us, SUPERSEDED, code)
        self.begin(move)
        move.slack_us += TAKEOVER_US
        self.duty = on
        if on:
            move.duties += (on,)  # until the firmware has come so far
            self.on_at, self._effect = us, 0.0
            move.drives += 1

    def end(self, us: int, reason: int, code: int) -> None:
        """The firmware has ended the move, with this error (0: none)."""
        self.advance(us)
        m = self.move
        assert m, f"ended ({reason}) although nothing moved: a second end of one move"
        assert not self.duty, "ended with the drive on"
        assert reason in self._reasons(m, code), f"ended with reason {reason} and error {code}: {m}"
        assert not (reason == STOPPED and m.finishing and m.cut), "ST cut a pulse that was nearly over"
        if reason in (STOPPED, ABORTED, SUPERSEDED) and m.off_at is not None and us - m.off_at < 300:
            if m.kind == "steps" and not (m.cut or m.finishing):
                raise Unclear  # it came while the firmware was ending the pulse
            cut_us = TAKEOVER_US if reason == SUPERSEDED else CUT_US
            m.slack_us += cut_us
            self.loosen(cut_us)
        self.move, self.last, self.reason = None, m, reason
        self.measure()
        if reason == DONE and m.to_zero:
            self.define(0, HOMED)

    def _reasons(self, m: Move, code: int) -> set[int]:
        """Why m may have ended with this error."""
        up = m.way > 0
        if m.kind == "steps" and m.pulses == abs(m.n):
            return {DONE} if not code else set()
        if not code:
            found = m.kind == "home" and self.opened(self.own(m.way))
            return m.causes | ({DONE} if found else set())
        if m.kind == "home":
            return {HOMING_FAILED} if self._homing_may_fail(m, code) else set()
        if code == (104 if up else 105) and self.opened(self.own(m.way)):
            return {END_STOP}
        if code == 140 and m.kind != "steps" and abs(m.on_us - m.limit_us) <= m.slack_us + EDGE_US:
            return {RUN_LIMIT}
        if code == (106 if up else 107) and m.soft_limit is not None:
            near = abs(self.position - m.soft_limit) <= self.slack + TAKEOVER_US * max(m.duties) / self.step
            return {SOFT_LIMIT} if near else set()
        return set()

    def _homing_may_fail(self, m: Move, code: int) -> bool:
        at_limit = abs(m.on_us - m.limit_us) <= m.slack_us + EDGE_US
        if code == 145:
            return at_limit
        if code == 146:
            return at_limit or m.on_us >= m.back_off_us - EDGE_US
        return code == (105 if m.way > 0 else 104) and self.opened(-self.own(m.way))

    def check_not_overdue(self) -> None:
        """What still moves must have a reason to."""
        m = self.move
        if not m:
            return
        assert not m.causes or m.finishing, f"moves on after a stop: {m}"
        assert not m.cut, f"moves on after a cut: {m}"
        if m.kind == "steps":
            assert m.pulses < abs(m.n), "moves on after its last pulse"
        else:
            assert m.on_us <= m.limit_us + m.slack_us + EDGE_US, "moves on beyond its limit"

    # ---- what is set

    def measure(self) -> None:
        """What makes a step, and a gap, from now on."""
        step = self.settings["XP"] * self.settings["XD"]
        if step != self.step and self.certainty != {UNKNOWN}:
            if abs(self.position) > self.slack:
                self.certainty = {ESTIMATED}
            elif self.slack:
                self.certainty = self.certainty | {ESTIMATED}
        self.step = step
        self.gap.resize(self.settings["XB"] * self.settings["XD"])

    def define(self, position: int, certainty: int) -> None:
        """The position here is known."""
        self.position, self.slack = float(position), 0.0
        self.certainty = {certainty}

    def invert(self, inverted: int) -> None:
        """XI: the spot stays where it is."""
        if inverted != self.settings["XI"]:
            self.position = -self.position
            self.gap.mirror()
