"""The mount at the board's own prompt. Imports build and codes, and the port by the interpreter's name.

    >>> from mountfw.repl import m
    >>> m.x.step(5)              # right; returns when it is done
    >>> m.y.jog(-0.3, ms=800)    # downwards at 30 % for 0.8 s
    >>> m.axes[2].step(1)        # axis 3, on a board that has one
    >>> m.status()

The axes are those of the firmware that was interrupted: same positions, settings and limits. Where the prompt
begins with an empty memory, as CircuitPython's does, they are new ones that know what was saved. Each call serves
them until its move is over, listens to Ctrl-C only, and leaves the motors off.
"""

import sys

from mountfw import codes
from mountfw.app import App
from mountfw.settings import MAX_STEPS

_SPIN_US = 2_000  # this long before a deadline only the clock is watched: more than one pass takes on an RP2040
_PAUSE_US = 500  # the longest pause while something moves: Ctrl-C waits for it

_LIMITS = ("-", "positive", "negative", "both")
_NAMES = ("y", "x", "axis3", "axis4")  # as the host names them


class MoveEnded(Exception):
    """A move ended before it was done."""


class Axis:
    """One axis: x (right is positive), y (up is positive), axis3 or axis4. axis is the firmware's own."""

    def __init__(self, mount, name, axis):
        self._mount = mount
        self.name = name
        self.axis = axis

    @property
    def position(self):
        """Where it is counted to be, in steps."""
        return self.axis.position_now() / 1000

    def step(self, n):
        """Move by n steps. Raises ValueError, MoveEnded."""
        _check_whole("steps", n, -MAX_STEPS, MAX_STEPS)
        self._mount.move((self,), self.axis.steps, n)

    def move_to(self, position):
        """Move to a position in steps, by the nearest whole number of steps. Raises ValueError, MoveEnded."""
        _check_whole("a position", position, -MAX_STEPS, MAX_STEPS)
        self._mount.move((self,), self.axis.move_to, position)

    def jog(self, speed, ms):
        """Run at speed, -1 ... 1 of full speed, for ms milliseconds. Raises ValueError, MoveEnded."""
        duty = round(speed * 255) if type(speed) in (int, float) and -1 <= speed <= 1 else 0
        if duty == 0:
            raise ValueError("speed is a number within -1 ... 1, and at least 1/255 either way")
        self.check_ms(ms)
        self._mount.move((self,), self.axis.frame, duty, ms)

    def check_ms(self, ms):
        """Raise ValueError if this axis may not run for ms."""
        _check_whole("ms", ms, 1, self.axis.run_limit_ms)


class Mount:
    """The axes of an App on a port: axes in the order of their numbers; y is the first, x the second.

    One move at a time: each call returns when it is over.
    """

    def __init__(self, port, firmware):
        self._port = port
        self._controller = firmware.controller
        self._show_led = firmware.show_led
        self.axes = tuple([Axis(self, name, axis) for name, axis in zip(_NAMES, self._controller.axes)])
        self.y, self.x = self.axes[:2]
        for a in self.axes:
            if a.axis.moving():  # the firmware was cut off before it could count
                a.axis.position.certainty = codes.UNKNOWN
        self.stop()
        self._controller.inhibit(codes.NONE_YET)
        firmware.poll_by(bool)  # does nothing: what is typed is the prompt's

    def drive(self, m1, m2, ms):
        """Drive motor 1 (y) and motor 2 (x) at -255 ... 255 for ms milliseconds. Raises ValueError, MoveEnded."""
        for name, duty, a in (("m1", m1, self.y), ("m2", m2, self.x)):
            _check_whole(name, duty, -255, 255)
            a.check_ms(ms)

        def start():
            return self.y.axis.frame(m1, ms) is not False and self.x.axis.frame(m2, ms) is not False

        self.move([a for duty, a in ((m1, self.y), (m2, self.x)) if duty], start)

    def stop(self):
        """All motors off."""
        self._port.uninterrupted(self._controller.shutdown, codes.ABORTED)

    def status(self):
        """Print the state of each axis and the errors that wait to be read."""
        for a in (self.x, self.y) + self.axes[2:]:
            known = (a.name, a.position, codes.CERTAINTY[a.axis.position.certainty], _LIMITS[a.axis.limits() & 3])
            print("%s: %+.3f steps (%s), end-stops: %s," % known, "last move:", codes.REASONS[a.axis.reason])
        while self._controller.errors.waiting:
            print("error", self._take_error())

    def move(self, axes, start, *arguments):
        """Start a move of these Axis objects and serve it to its end; motors off however it ends."""
        while self._controller.errors.pop():
            pass  # those of before would be taken for this move's
        try:
            try:
                if start(*arguments) is False:
                    raise ValueError(axes[0].name + ": " + self._take_error())
                self._serve(axes)
            finally:
                self.stop()
        finally:
            self.stop()  # again: a second Ctrl-C may have kept the first one from starting

    def _serve(self, axes):
        while True:
            for a in axes:
                if not a.axis.moving() and a.axis.reason != codes.DONE:
                    why = self._take_error() or codes.REASONS[a.axis.reason]
                    raise MoveEnded("%s: %s after %d steps" % (a.name, why, abs(a.axis.ended_steps)))
            if not self._controller.moving():
                return
            now_us = self._port.ticks_us()
            left_us = self._controller.service(now_us)
            ending = self._controller.ending(now_us, _SPIN_US)
            if ending:
                ending.drive.end_on_time(bool, 0)
                continue
            self._show_led()
            if left_us > _SPIN_US and not self._controller.watching():
                self._port.pause_us(min(left_us - _SPIN_US, _PAUSE_US))

    def _take_error(self):
        code = self._controller.errors.pop()
        return codes.message(code).decode().lower() if code else ""


def _check_whole(what, value, least, most):
    if type(value) is not int or not least <= value <= most:
        raise ValueError("%s: a whole number within %d ... %d, not %s" % (what, least, most, repr(value)[:20]))


def _connect():
    app = App.built
    if app is None:  # the firmware has not run since the reset
        from mountfw.build import build

        name = sys.implementation.name
        port = getattr(__import__("mountfw.ports." + name).ports, name)
        board = port.find_board()
        if board is None:
            raise RuntimeError("this board has no board file")
        app = build(port, board)
    return Mount(app.port, app)


m = _connect()
