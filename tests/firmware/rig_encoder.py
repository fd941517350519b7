"""Motors with encoders for the rig: they turn as the pins say, and readers count what they have turned.

Runs under CPython and under MicroPython. A motor takes 20 ms to come to its speed, and coasts on; its closed form is
solved from edge to edge, so a reading may come at any time.
"""

from math import exp, log

from rig import START_US, Board, Port, Rig

SPEED = 1475  # counts per second at full drive: 0.125 turns of a screw of 11800
TAU_S = 0.02
DRY = 59_000  # counts per second squared: without drive
FLOOR = DRY * TAU_S
PINS = ((2, 3, 4), (5, 6, 7))


class Motor:
    """A motor on the pins of one axis, and the reader of its encoder."""

    def __init__(self, port, pins):
        self.port = port
        self.enable, self.pos, self.neg = pins
        self.supply = 1.0
        self.sign = 1  # of the encoder
        self.stuck = False  # does the motor not turn?
        self.ends = (-1e9, 1e9)  # counts: there it stalls
        self.broken = False  # does a wire carry nothing?
        self.at = 0.0  # counts
        self.speed = 0.0
        self.levels = {2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 7: 0}
        self.us = 0
        self.seen = 0
        self.slips = 0
        self.gone = False
        self.play_us = 0
        self.play = 0.0  # counts that the motor turns before the encoder does: gears in between
        self.shaft = 0.0
        self.held = 0
        self.reads = 0

    def counts(self):
        """As of a reader."""
        self.port.unlock()
        self.port.us += 40
        self.reads += 1
        self.catch_up()
        self.shaft = max(self.at - self.play / 2, min(self.at + self.play / 2, self.shaft))
        if not self.broken:
            self.held = int(self.shaft // 1) * self.sign
        held = self.held
        self.port.lock()
        return held

    def catch_up(self):
        """Turn as the pins were until now."""
        edges = self.port.edges
        while self.seen < len(edges):
            us, pin, duty = edges[self.seen]
            self.seen += 1
            self.turn(us)
            self.levels[pin] = duty
        self.turn(self.port.us - START_US)

    def turn(self, us):
        dt = (us - self.us) / 1e6
        self.us = us
        level = self.levels
        way = (1 if level[self.pos] else 0) - (1 if level[self.neg] else 0)
        drive = way * level[self.enable] / 65535
        if self.stuck or dt <= 0:
            self.speed = 0.0 if self.stuck else self.speed
            return
        if drive:
            target = drive * SPEED * self.supply
            fade = exp(-dt / TAU_S)
            self.at += target * dt + (self.speed - target) * TAU_S * (1 - fade)
            self.speed = target + (self.speed - target) * fade
        elif self.speed:
            sign, speed = (1, self.speed) if self.speed > 0 else (-1, -self.speed)
            rest = TAU_S * log(1 + speed / FLOOR)
            t = min(dt, rest)
            fade = exp(-t / TAU_S)
            self.at += sign * ((speed + FLOOR) * TAU_S * (1 - fade) - FLOOR * t)
            self.speed = 0.0 if t == rest else sign * ((speed + FLOOR) * fade - FLOOR)
        low, high = self.ends
        if not low <= self.at <= high:
            self.at = low if self.at < low else high
            self.speed = 0.0


class EncoderPort(Port):
    """A port whose axes have such motors."""

    def __init__(self, files=None):
        super().__init__(files)
        self.motors = tuple([Motor(self, pins) for pins in PINS])

    def encoder(self, number, pins):
        return self.motors[number - 1]


def encoded(files=None, settings=b"XN280;MM1;DB1", port=EncoderPort):
    """A rig with encoders on both axes, in the closed loop."""
    board = Board()
    board.AXIS_1 = dict(board.AXIS_1, encoder=(8, 9))
    board.AXIS_2 = dict(board.AXIS_2, encoder=(26, 27))
    rig = Rig(board, files, port(files))
    rig.motor1, rig.motor2 = rig.port.motors
    for line in settings.split(b";"):
        if line:
            rig.ask(b"1%s;2%s\n" % (line, line))
    return rig


def finish(rig, most_us=60_000_000):
    """Let the loop run until nothing moves."""
    until = rig.port.us + most_us
    while rig.controller.moving():
        assert rig.port.us < until, "it never ends"
        rig.port.horizon_us = rig.port.us + 1_000_000
        rig.step()


def move(rig, line):
    rig.send(line)
    rig.settle()
    finish(rig)
    rig.run(60_000)


def ended(rig, axis=1):
    """Reason, whole steps and errors of the last move."""
    reason, steps, _ = rig.ask(b"%dXE?\n" % axis).split(b",")
    return int(reason), int(steps), rig.errors()


def why(rig):
    """The same without the steps."""
    reason, _, errors = ended(rig)
    return reason, errors


def status(rig):
    """Position in millisteps, and certainty, of axis 1."""
    words = rig.ask(b"XS?\n").split(b"|")[1].split(b",")
    return int(words[0]), int(words[5])


class GearedPort(EncoderPort):
    """A port whose encoders sit behind gears with play, as an AS5600 does: 97 counts a step, and 0.08 s of play."""

    def __init__(self, files=None):
        super().__init__(files)
        for motor in self.motors:
            motor.play_us = 300_000
            motor.play = 40.0
            motor.supply = 97 / 280
