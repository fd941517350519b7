"""Direction buttons on the mount: a press is a step, a button that is held longer runs until it is released."""

from collections.abc import Callable

from mirrormount.common.errors import BoardError
from mirrormount.device.mount import Mount
from mirrormount.supervise.lease import Client
from mirrormount.supervise.presses import Hold, Presses
from mirrormount.supervise.state import State


class Pad:
    """presses: those under way. Methods say which thread calls them. stop(cause): stops all motors."""

    def __init__(self, state: State, clock: Callable[[], float], stop: Callable[[str], None]) -> None:
        self.presses = Presses()
        self._state = state
        self._clock = clock
        self._stop = stop
        self._stepping = False  # by a press, and not seen to be over

    # ---- any thread

    def add(self, hold: Hold) -> bool:
        """A button has gone down. True if its press waits now; a refusal becomes a notice of its client."""
        last = self.presses.last
        if last and not last.released:
            return False  # one hand at a time
        if self.presses.full:
            hold.client.notices.append(f"this press was not counted: {len(self.presses)} steps wait already")
            return False
        self.presses.add(hold)
        return True

    def release(self, client: Client) -> bool:
        """The client's button is up. True if it ran: its run must be stopped."""
        hold = self.presses.last
        if not hold or hold.client is not client or hold.released:
            return False
        hold.released = True
        return hold.running or hold.is_run(self._clock())

    # ---- the mount's thread

    @property
    def held(self) -> Hold | None:
        """The button that is down."""
        hold = self.presses.current
        return hold if hold and not hold.released else None

    def pop(self) -> Hold | None:
        """The press that may begin now; None while the step of one before it is under way."""
        now_s, before = self._clock(), self.presses.current
        if self._stepping or (before and not before.released and before.begun_s is not None):
            self.presses.postpone(now_s)
            return None
        return self.presses.pop()

    def step(self, mount: Mount, hold: Hold) -> None:
        """Begin the steps of a press. Raises MountError."""
        for name, steps in hold.press.steps.items():
            self._state.targets[name] = None
            try:
                mount.axis(name).step(steps, wait=False, feed=False)
            except BoardError:
                if len(hold.press.steps) > 1:  # one axis of two
                    self._stop("one axis of a diagonal step was refused")
                raise
            self._state.began(name)
        self._stepping = True
        hold.begun_s = self._clock()

    def hold_to_run(self) -> Hold | None:
        """The button that has just been held for long enough to run."""
        hold = self.held
        if not hold or hold.running or not hold.is_run(self._clock()):
            return None
        hold.running = True  # before it does: a release from here on stops it
        return hold

    def run(self, mount: Mount, hold: Hold) -> None:
        """Begin the run of a button that is held. Raises MountError."""
        for name, speed in hold.press.run.items():
            if not hold.released:
                mount.axis(name).jog(speed, feed=False)

    def report_errors(self, moving: bool) -> None:
        """The board has reported errors: no press goes on."""
        hold = self.held
        if hold and hold.running and moving:
            self._stop("the board reported an error in a run")  # drop() alone would lose the release
        self.presses.drop()

    def rest(self) -> bool:
        """Nothing moves. True if no button is down and no press waits."""
        self._stepping = False
        return not self.presses and self.held is None

    def reset(self) -> None:
        """After a stop: no step is under way."""
        self._stepping = False
