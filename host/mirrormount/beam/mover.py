"""Moves several actuators at once, in steps of travel, and watches the spot meanwhile. Imports looking, response."""

import math
from collections.abc import Callable, Mapping

from mirrormount.beam.events import CORRECT, MEASURE, Listen, Pulsed
from mirrormount.beam.looking import Looker, Misses
from mirrormount.beam.loop_table import Actuator, LoopTable
from mirrormount.beam.response import Response

SHORTEST_US = 5000  # of a pulse: a shorter one of a rough motor moves nothing at times
_POLL_S, _SOON_S = 0.03, 0.01
_REST_S = 0.05  # of a pulse, after it
_LONG_US = 100_000  # the spot is watched during longer motions


class SpotLostMoving(Exception):
    """The spot was lost during a motion, and the motors were stopped. Never leaves the loop."""


class Mover:
    """Moves the actuators of a table. actions, reversals: counted since the beginning."""

    def __init__(self, table: LoopTable, looker: Looker, listen: Listen) -> None:
        self.table = table
        self.actions = self.reversals = 0
        self.motor_s = 0.0
        self._looker = looker
        self._listen = listen
        self._ways = [0] * len(table.actuators)

    def travel(
        self, response: Response, travels: Mapping[int, float], purposes: Mapping[int, str] | None = None
    ) -> dict[int, tuple[float, float]]:
        """Turn shafts by steps (signed), all at once. Returns for each the way that is expected, and its scatter.

        A way of less than the shortest pulse's is made longer: that is in what is returned. Raises as Actuator does,
        and SpotLostMoving.
        """
        whole: dict[int, int] = {}
        parts: dict[int, int] = {}
        made: dict[int, tuple[float, float]] = {}
        for i, steps in travels.items():
            way = 1 if steps > 0 else -1
            n = int(abs(steps))
            rest = abs(steps) - n
            us = response.pulse_us(i, way, rest, SHORTEST_US) if rest > 0 else 0
            if n and us <= SHORTEST_US:
                us = 0
            if n:
                whole[i] = way * n
            if us:
                parts[i] = way * us
            part = response.pulse_steps(i, way, us) if us else 0.0
            scatter = math.hypot(math.sqrt(n) * response.scatter(self.table.actuators[i].step_us), 0.0)
            scatter = math.hypot(scatter, part * response.scatter(us)) if us else scatter
            made[i] = way * (n + part), scatter
            length = way * (n * self.table.actuators[i].step_us + us)
            self._tell(i, length, (purposes or {}).get(i, CORRECT))
        self.steps(whole)
        self.pulses(parts)
        self._looker.moved()
        return made

    def measure(self, steps: Mapping[int, int]) -> None:
        """Whole steps for a calibration."""
        for i, n in steps.items():
            self._tell(i, n * self.table.actuators[i].step_us, MEASURE)
        self.steps(steps)
        self._looker.moved()

    def measure_pulses(self, us: Mapping[int, int]) -> None:
        """One pulse each for a calibration."""
        for i, length in us.items():
            self._tell(i, length, MEASURE)
        self.pulses(us)
        self._looker.moved()

    def steps(self, steps: Mapping[int, int]) -> None:
        """Whole steps, all at once, to their end."""
        self._run({i: n for i, n in steps.items() if n}, lambda a, n: a.step(n), max_us=_LONG_US + 1)

    def pulses(self, us: Mapping[int, int]) -> None:
        """One pulse each, all at once, to their end."""
        longest = max((abs(length) for length in us.values()), default=0)
        self._run(us, lambda a, length: a.pulse(length), max_us=longest)

    def _run(self, amounts: Mapping[int, int], begin: Callable[[Actuator, int], None], *, max_us: int) -> None:
        """Begin, and wait for the end; however it ends early, all motors are off."""
        if not amounts:
            return
        moving = [self.table.actuators[i] for i in amounts]
        misses = Misses()
        try:
            for i, amount in amounts.items():
                begin(self.table.actuators[i], amount)
            if max_us <= _LONG_US:
                self.table.sleep(max_us * 1e-6 + _REST_S)
            while moving := [actuator for actuator in moving if actuator.is_moving()]:
                if max_us <= _LONG_US:
                    self.table.sleep(_SOON_S)
                    continue
                before_s = self.table.now_s()
                if misses.too_many(self._looker.glance()):
                    raise SpotLostMoving
                self.table.sleep(_POLL_S - (self.table.now_s() - before_s))
        except BaseException:
            try:
                self.table.stop()
            finally:
                self._looker.moved()
            raise

    def _tell(self, i: int, us: int, purpose: str) -> None:
        way = 1 if us > 0 else -1
        self.actions += 1
        if self._ways[i] == -way:
            self.reversals += 1
        self._ways[i] = way
        self.motor_s += abs(us) * 1e-6
        self._listen(Pulsed(self.table.now_s(), self.table.actuators[i].name, us, purpose))
