"""The clients of one mount: which are connected, which one has control, and which are alive. Pure.

A client is a page of the panel, a camera loop, or any other program. At most one has control; all may stop.
A client is alive while its last sign of life is younger than the patience. A client in this process gives one by
beat(). A remote client returns the last tick, which is the lease's own clock: the age of a returned tick is how
long ago client and network were known to work, and a request that was held back carries an old tick.
"""

import itertools
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field

from mirrormount.errors import NotInControl
from mirrormount.values import PATIENCE_S

TICK_S = 0.05  # period of the ticks that a remote client is sent


@dataclass(eq=False)
class Client:
    """A client of the mount.

    is_person: may take control from any other. seen_s: the lease's time of its last sign of life.
    patience_s: silence after which it is not alive; None: the lease's.
    connection: what it is connected by, None while it is not. notices: refusals, to be shown to this client only.
    claimed_at: how many stops there had been when it took control.
    """

    name: str
    is_person: bool = False
    patience_s: float | None = None
    seen_s: float = float("-inf")
    connection: object = None
    claimed_at: int = 0
    notices: deque[str] = field(default_factory=lambda: deque(maxlen=20))

    @property
    def connected(self) -> bool:
        """True from join() to leave()."""
        return self.connection is not None

    def lost_control(self, cause: str) -> None:
        """Called once when control ends otherwise than by leave(). Any thread; must return at once."""


@dataclass(eq=False)
class Question:
    """A client's question for control, to the person who has it. number: an answer names the question by it.

    outcome: None: it has control; raises NotInControl: control is kept. To cancel it is to withdraw the question.
    """

    number: int
    client: Client
    outcome: "Future[None]" = field(default_factory=Future)


class Lease:
    """All connected clients, and who has control (holder). Any thread may call it.

    patience_s: silence after which a client is not alive that has no patience of its own.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, patience_s: float = PATIENCE_S) -> None:
        self._clock = clock
        self.patience_s = patience_s
        self._lock = threading.Lock()
        self._clients: list[Client] = []
        self._questions: list[Question] = []
        self._numbers = itertools.count(1)
        self.holder: Client | None = None
        self.stops = 0  # requested so far; counted up by the worker, also in a signal handler: without the lock

    @property
    def clients(self) -> tuple[Client, ...]:
        """All that are connected."""
        return tuple(self._clients)

    def tick(self) -> int:
        """The lease's clock, in ms."""
        return int(self._clock() * 1000)

    def join(self, client: Client, connection: object) -> None:
        """Connect a client; an older connection of it counts no more. A person gets control if it is free."""
        with self._lock:
            client.connection = connection
            client.seen_s = self._clock()
            if client not in self._clients:
                self._clients.append(client)
            if self.holder is None and client.is_person:
                self.holder = client

    def leave(self, client: Client, connection: object) -> bool:
        """End this connection. True if the client has gone with it; its control has ended then, too."""
        with self._lock:
            if client.connection is not connection or client not in self._clients:
                return False
            client.connection = None
            client.seen_s = float("-inf")
            self._clients.remove(client)
            if self.holder is client:
                self.holder = None
            question = self._withdraw(client)
        if question:
            question.outcome.cancel()
        return True

    def receive(self, client: Client, tick: object) -> bool:
        """Take a returned tick as a sign of life. True if it is fresh: a request with it may be carried out."""
        if isinstance(tick, bool) or not isinstance(tick, int):
            return False
        seen_s = max(0, min(tick, self.tick())) / 1000
        client.seen_s = max(client.seen_s, seen_s)
        return self._clock() - seen_s <= self.patience_of(client)

    def patience_of(self, client: Client) -> float:
        """Silence of this client after which it is not alive, in seconds."""
        return self.patience_s if client.patience_s is None else client.patience_s

    def beat(self, client: Client) -> None:
        """A sign of life of a client in this process."""
        client.seen_s = self._clock()

    def alive(self, client: Client) -> bool:
        """True if the client is connected and its last sign of life is fresh."""
        return client.connected and self._clock() - client.seen_s <= self.patience_of(client)

    def silence_of(self, client: Client) -> str:
        """What is told of a client that is not alive while it moves something: it has left; or cause and remedy."""
        if not client.connected:
            return f"{client.name}, which had asked for the motion, has gone"
        return (
            f"{client.name}, which had asked for the motion, is out of touch (silent for more than"
            f" {self.patience_of(client):g} s): end what keeps computer or network busy, or wait longer for it:"
            " --patience S"
        )

    def claim(self, client: Client) -> bool:
        """Give control to a client. True if another had it: its motion is to be stopped, and stops counts that.

        A person keeps control over a stop; any other client has it until the next stop, whoever asked for that.
        Raises NotInControl if the client is not connected, or is no person and a person or a live program has control.
        """
        with self._lock:
            holder = self.holder if self.holder is not client else None
            if not client.connected:
                raise NotInControl(f"nothing was done: {client.name} has left")
            if holder and not client.is_person and (holder.is_person or self.alive(holder)):
                raise NotInControl(f"nothing was done: {holder.name} has control")
            self.holder = client
            if holder:
                self.stops += 1
            client.claimed_at = self.stops
            question = self._withdraw(client)
        if holder:
            holder.lost_control(f"{client.name} took control")
        if question and question.outcome.set_running_or_notify_cancel():
            question.outcome.set_result(None)
        return holder is not None

    def take_over(self, person: Client, cause: str) -> None:
        """Give a person the control that no person has, after a stop for that cause."""
        with self._lock:
            holder = self.holder
            if not person.connected or (holder and holder.is_person):
                return
            self.holder = person
            person.claimed_at = self.stops
        if holder:
            holder.lost_control(f"stopped: {cause}")

    # ---- a question for control, and its answer

    @property
    def question(self) -> Question | None:
        """The oldest question that waits for an answer."""
        return next((question for question in tuple(self._questions) if not question.outcome.done()), None)

    def ask(self, client: Client) -> "Future[None]":
        """Ask the person who has control to hand it over; a client has one question at a time. Returns the outcome.

        Raises NotInControl if the client is not connected, or no person has control.
        """
        with self._lock:
            holder = self.holder
            if not client.connected:
                raise NotInControl(f"nothing was done: {client.name} has left")
            if holder is None or not holder.is_person:
                raise NotInControl(f"nothing was done: {holder.name if holder else 'nobody'} has control")
            question = self._withdraw(client)
            if question is None or question.outcome.done():
                question = Question(next(self._numbers), client)
            self._questions.append(question)
            return question.outcome

    def hand_over(self, person: Client, number: object) -> Question:
        """Give control to the client that has asked. Its motion is to be stopped, and stops counts that.

        Returns the question, whose outcome is to be set after that stop. Raises NotInControl if the person does not
        have control, or that question does not wait any more.
        """
        with self._lock:
            question = self._answered(person, number)
            self.holder = question.client
            self.stops += 1
            question.client.claimed_at = self.stops
            return question

    def keep(self, person: Client, number: object) -> None:
        """Refuse a question for control. Raises as hand_over()."""
        with self._lock:
            question = self._answered(person, number)
        question.outcome.set_exception(NotInControl(f"nothing was done: {person.name} keeps control"))

    def _withdraw(self, client: Client) -> Question | None:
        """Remove the client's question, and return it."""
        mine = next((question for question in self._questions if question.client is client), None)
        if mine:
            self._questions.remove(mine)
        return mine

    def _answered(self, person: Client, number: object) -> Question:
        if self.holder is not person:
            raise NotInControl(f"nothing was done: {person.name} does not have control")
        for question in self._questions:
            if question.number == number and question.outcome.set_running_or_notify_cancel():
                self._questions.remove(question)
                return question
        raise NotInControl("nothing was done: that question for control was withdrawn or answered")

    # ---- who has it

    def check(self, client: Client) -> None:
        """Raises NotInControl if the client does not have control."""
        holder = self.holder
        if holder is not client:
            who = f"{holder.name} has control" if holder else f"{client.name} does not have control"
            raise NotInControl(f"nothing was done: {who}")
        if not client.is_person and client.claimed_at != self.stops:
            raise NotInControl(f"nothing was done: after a stop {client.name} must take control again")

    def has_control(self, client: Client) -> bool:
        """True if check() raises nothing."""
        return self.holder is client and (client.is_person or client.claimed_at == self.stops)

    def count_own_stop(self, client: Client) -> bool:
        """Count a stop through which the client that asks for it keeps control. False if it does not have control."""
        with self._lock:
            if not self.has_control(client):
                return False
            self.stops += 1
            client.claimed_at = self.stops
            return True

    def end_stopped(self, cause: str) -> None:
        """Release a holder whose control a stop has ended."""
        with self._lock:
            holder = self.holder
            if holder is None or holder.is_person or holder.claimed_at == self.stops:
                return
            self.holder = None
        holder.lost_control(cause)
