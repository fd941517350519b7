"""A person for `mirrormount setup`, who looks at the virtual screen and presses virtual switches."""

import re

from mirrormount.cli.setup import run_course
from mirrormount.device.mount import Mount


class Person:
    """Answers what setup asks from what is to be seen on the bench. said: what setup told; asked: its questions.

    answers: {part of a question: answers to give, one after the other, before looking at the bench}. An
    answer that is an exception is raised.
    """

    def __init__(
        self,
        mount: Mount,
        answers: dict[str, list] | None = None,
        *,
        distance_mm: float = 0,
        wires_swapped: bool = False,
    ) -> None:
        self.bench = mount.link.port.simulation.bench
        self.answers = answers or {}
        self.spot = self.bench.spot_mm()
        self.said: list[str] = []
        self.asked: list[str] = []
        self.distance_mm = distance_mm
        self.swapped = wires_swapped

    def say(self, text: str) -> None:
        self.said.append(text)

    def __call__(self, question: str) -> str:
        self.asked.append(question)
        self.bench.broken.clear()
        for part, answers in self.answers.items():
            if part in question and answers:
                answer = answers.pop(0)
                if isinstance(answer, BaseException):
                    raise answer
                return answer
        return next(reply(self, question) for part, reply in REPLIES.items() if part in question)

    def way(self, _question: str) -> str:
        before, self.spot = self.spot, self.bench.spot_mm()
        x, y = self.spot[0] - before[0], self.spot[1] - before[1]
        if max(abs(x), abs(y)) < 0.5:
            return "nothing"
        return ("right" if x > 0 else "left") if abs(x) > abs(y) else ("up" if y > 0 else "down")

    def press(self, question: str) -> str:
        side = re.search(r"the (\w+) switch", question)[1]
        motor = "m2" if side in ("right", "left") else "m1"
        positive = (side in ("right", "up")) != self.swapped
        self.bench.broken.add(f"{motor}_sw_{'pos' if positive else 'neg'}")
        self.swapped = False  # and exchanges the wires when told to
        return ""

    def read(self, question: str) -> str:
        return f"{self.bench.spot_mm()['right' not in question]:.1f}"


REPLIES = {
    "May it move": lambda person, question: "yes",
    "Which way": Person.way,
    "End-stop switches": lambda person, question: "both",
    "Press the": Person.press,
    "Find the least duty": lambda person, question: "no",
    "Distance": lambda person, question: f"{person.distance_mm:g}",
    "Angle": lambda person, question: "45",
    "Steps from": lambda person, question: "8",
    "Where is the spot": Person.read,
    "Save this": lambda person, question: "yes",
}


def set_up(mount: Mount, answers: dict[str, list] | None = None, **more) -> Person:
    person = Person(mount, answers, **more)
    run_course(mount, person, person.say)
    return person
