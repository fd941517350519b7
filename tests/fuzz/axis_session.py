"""A rig and axis_model.py side by side: what the firmware did is told to the model, and what it says is compared.

Every write to `Axis.reason` is taken as an end, for that is what XE? and XS? tell. The model has one move under way
or none, so a second end of a move, or one of none, fails at once, and a move that does not end is overdue.
"""

from axis_commands import AT_REST, ERRORS_OF, MOTIONS, STOPS, Switches, causes, text_of
from axis_model import AxisModel
from axis_move import (
    COUNTED,
    DONE,
    SUPERSEDED,
    outcomes,
    possible_velocity,
    started,
)
from rig import Rig

from mountfw.motion.axis import Axis

MOST_ON_US = 1_000_000_000  # docs/protocol.md: XE? counts no further


class Session:
    """A rig and the model of its axis 1."""

    def __init__(self, values: dict[str, int], ends_us: tuple[int, int]) -> None:
        self.values, self.ends_us = values, ends_us
        self.rig = rig = Rig()
        for name in ("XP", *values):  # the pulse first: VA must go with it
            rig.ask(text_of(name, values[name]))
        assert set(rig.errors()) <= {110}
        rig.port.edges.clear()
        ends = (ends_us[0] * 255, ends_us[1] * 255)
        self.model = AxisModel({"XI": 0, "ZH": 0, "SL": -999_999, "SR": 999_999, **values}, ends, rig.now())
        rig.port.switches = Switches(rig, ends)
        self.ends: list[tuple[int, int]] = []  # (us, reason)
        self.told = 0  # of these
        self.note_ends()

    def note_ends(self) -> None:
        """Write down each time that the firmware says why a move has ended."""
        rig, ends = self.rig, self.ends

        class Noted(Axis):
            @property
            def reason(self) -> int:
                return ends[-1][1] if ends else 0

            @reason.setter
            def reason(self, value: int) -> None:
                ends.append((rig.now(), value))

        rig.axis1.__class__ = Noted

    # ---- what happens

    def happened(self) -> tuple[list, list, list]:
        """Edges, ends with their errors, and the errors that are left, since it was asked last."""
        errors, ends = [], []
        while code := self.rig.controller.errors.pop():
            if code < 200:
                errors.append(code)
        for us, reason in self.ends[self.told :]:
            code = next((code for code in errors if code in ERRORS_OF.get(reason, ())), 0)
            if code:
                errors.remove(code)
            ends.append((us, reason, code))
        self.told = len(self.ends)
        self.rig.port.switches.get(0)  # it follows the edges
        edges = list(self.rig.port.edges)
        self.rig.port.edges.clear()
        self.rig.port.switches.seen = 0
        return edges, ends, errors

    def go_on(self, edges: list, ends: list) -> None:
        """Tell the model, in order."""
        events = sorted([(e[0], 0, e) for e in edges] + [(e[0], 1, e) for e in ends], key=lambda event: event[:2])
        for _, is_end, event in events:
            (self.model.end if is_end else self.model.edge)(*event)
        self.model.advance(self.rig.now())

    def wait(self, us: int) -> None:
        """Let time pass; nothing but ends may happen."""
        self.rig.run(us)
        edges, ends, errors = self.happened()
        assert not errors, f"error {errors} for no reason"
        self.go_on(edges, ends)
        self.model.check_not_overdue()

    def obey(self, name: str, value: int, stop: str) -> None:
        """Send a command, with a stop in the same breath or ""."""
        model, rig = self.model, self.rig
        self.wait(0)
        moved = model.move
        rig.send(text_of(name, value) + stop.encode() + b"\n")
        rig.take_in()
        while rig.app._receiver.unparsed or rig.app._commands.busy:
            rig.step()
        edges, ends, errors = self.happened()
        accepted = name in MOTIONS and not errors and not (name == "frame" and value == 0)
        causes(model, name, value, stop)
        if accepted:
            self._accept(name, value, edges, ends, stop)
        else:
            self.go_on(edges, ends)
            self._refused(name, value, errors, moved)
        model.check_not_overdue()

    def _accept(self, name: str, value: int, edges: list, ends: list, stop: str) -> None:
        model, n = self.model, self.rig.axis1.last_relative
        if model.move:
            assert ends, f"{name} was accepted although it moved"
            us, reason, code = ends.pop(0)
            if reason == SUPERSEDED:
                us = min([e[0] for e in edges if us - 300 <= e[0] <= us and e[1] in (2, 3, 4)] + [us])
                self._feed(edges, us)
                model.take_over(us, started(model, name, value, n), code)
                return self._rest(edges, ends, stop)
            self._feed(edges, us + 1)
            model.end(us, reason, code)
        assert n in outcomes(model, name, value).get(0, ()) or name not in ("PR", "PA"), "accepted, or so many steps"
        assert 0 in outcomes(model, name, value), f"{name}{value} was accepted"
        model.begin(started(model, name, value, n))
        return self._rest(edges, ends, stop)

    def _feed(self, edges: list, until: int) -> None:
        while edges and edges[0][0] < until:
            self.model.edge(*edges.pop(0))

    def _rest(self, edges: list, ends: list, stop: str) -> None:
        if stop:
            assert self.model.move
            self.model.move.causes |= {STOPS[stop], 3}  # it was held: ended before the stop was parsed
        self.go_on(edges, ends)

    def _refused(self, name: str, value: int, errors: list, moved: object) -> None:
        model = self.model
        if not errors:
            assert not (name in AT_REST and model.move), f"{name} was accepted although it moves"
            self._set(name, value)
            return
        (code,) = errors
        if code == 114:
            assert moved, f"{name} was refused although nothing moves"
            assert name in MOTIONS or name in AT_REST, f"{name} was refused"
        elif code == 110:  # told, and kept
            assert name == "VA" and value > possible_velocity(value, model.settings["XP"])
            self._set(name, value)
        elif code == 7:  # the value is looked at first
            assert name == "XU" and abs(value) < 200
        else:
            assert not model.move, f"{name}: error {code} instead of 114"
            assert code in outcomes(model, name, value), f"{name}{value} was refused with {code}"

    def _set(self, name: str, value: int) -> None:
        model = self.model
        if name == "DH":
            model.define(value, COUNTED)
        if name == "XI":
            model.invert(value)
            if value != model.settings["XI"]:  # the soft limits stay where they are
                model.settings["SL"], model.settings["SR"] = -model.settings["SR"], -model.settings["SL"]
        if name in model.settings:
            model.settings[name] = value
            if not model.move:
                model.measure()

    # ---- what is asked

    def check(self) -> None:
        """What the firmware says agrees with the model."""
        for _ in range(10):
            self.wait(0)
            model, before = self.model, self.model.position
            low_slack, certainty = model.position_slack(), model.certainty
            answer = self._ask(b"XS?;1XE?;1TP?;1MD?;1PR?\n")
            edges, ends, errors = self.happened()
            self.go_on(edges, ends)
            assert not errors
            if not (edges or ends):
                model.certainty = certainty | model.certainty
                return self._compare(answer, before, max(low_slack, model.position_slack()))
        return None

    def _ask(self, line: bytes) -> list[str]:
        rig = self.rig
        rig.port.sent.clear()
        rig.send(line)
        rig.take_in()
        while not rig.port.sent.endswith(b"\r\n") or b"|" not in rig.port.sent:
            rig.step()
        return rig.port.sent.decode().split("\r\n")[-2].split("; ")

    def _compare(self, answer: list[str], before: float, slack: float) -> None:
        model, rig = self.model, self.rig
        millisteps, moving, way, limits, reason, certainty = map(int, answer[0].split("|")[1].split(","))
        _, steps, on_us = map(int, answer[1].split(","))
        low, high = sorted((before, model.position))
        said = f"{millisteps / 1000} instead of {low} to {high} +- {slack}"
        assert low - slack <= millisteps / 1000 <= high + slack, said
        assert abs(int(answer[2]) - millisteps / 1000) <= 0.5 + abs(high - low) + 0.001
        assert moving == (model.move is not None) == (answer[3] == "0"), f"moving {moving}, MD? {answer[3]}"
        assert not model.move or model.move.kind == "home" or way == model.move.way
        assert model.move or (way == 0 and rig.drives()[0] == 0 and rig.port.pins[2] == 0)
        assert rig.axis2.moving() or rig.port.pins[5] == 0
        assert model.duty or limits == self._limits(), "end-stops"
        assert certainty in model.certainty, f"certainty {certainty} instead of {model.certainty}"
        if not model.duty:
            model.certainty = {certainty}
        last = model.last
        assert reason == int(answer[1].split(",")[0]) == model.reason
        assert abs(on_us - min(last.on_us, MOST_ON_US)) <= last.slack_us, f"{on_us} us under drive instead of {last}"
        part = abs(steps - last.moved)
        assert (
            part < 0.0001 or (part < last.drives + 0.1 and last.kind != "steps") or (part < 1.1 and last.is_part())
        ), f"{steps} steps: {last}"

    def _limits(self) -> int:
        model, fitted = self.model, self.model.settings["XL"]
        positive = bool(fitted & 1) and model.screw >= model.ends[1]
        negative = bool(fitted & 2) and model.screw <= model.ends[0]
        return negative | positive << 1 if model.settings["XI"] else positive | negative << 1

    def finish(self) -> None:
        """Whatever moves comes to its end by itself."""
        m = self.model.move
        until = self.rig.now() + (2 * m.limit_us + abs(m.n) * m.period_us + 1_000_000 if m else 0)
        while self.model.move and self.rig.now() < until:
            self.wait(300_000)
        assert not self.model.move, f"never ends: {self.model.move}"
        self.check()
        self.wait(600_000)
        assert self.rig.drives()[0] == 0
        assert self.model.last.causes or self.model.reason in (0, DONE, *ERRORS_OF)
