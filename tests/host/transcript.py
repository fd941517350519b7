"""A port that is a transcript: what the host must say, and what the board then answers.

Whatever the host sends beyond it, or leaves out, fails the test. The traffic that every opening and
every start of a motion has is put in by opened() and started().
"""

from mirrormount.device.mount import Mount
from mirrormount.transport.link import Link

IDENTITY = "mirrormount,Raspberry Pi Pico,e661,0.3.0"
NO_ERROR = "0, NO ERROR DETECTED"
AT_REST = "7,100,0|0,0,0,0,1,1|0,0,0,0,1,1"


class TranscriptPort:
    """Takes [(line, answer or None)] in order; time passes in read() and sleep() only.

    A line that ends in " …" is taken as often as it is said.
    """

    lockstep = True

    def __init__(self, lines: list[tuple[str, str | None]]) -> None:
        self.left = lines
        self._now = 0.0
        self._said = bytearray()
        self._answers = bytearray()

    def monotonic(self) -> float:
        return self._now

    def sleep(self, seconds: float) -> None:
        self._now += seconds

    def read(self, timeout_s: float) -> bytes:
        if not self._answers:
            self._now += timeout_s
        answers = bytes(self._answers)
        self._answers.clear()
        return answers

    def write(self, data: bytes) -> None:
        self._said += data
        while b"\n" in self._said:
            line, _, rest = bytes(self._said).partition(b"\n")
            self._said[:] = rest
            assert self.left, f"the host also says {line!r}"
            while self.left[0][0].endswith(" …") and self.left[0][0] != line.decode() + " …":
                self.left.pop(0)
            expected, answer = self.left[0]
            assert line.decode() == expected.removesuffix(" …"), f"the host says {line!r}, not {expected!r}"
            if expected == line.decode():
                self.left.pop(0)
            if answer is not None:
                self._answers += answer.encode() + b"\r\n"

    def close(self) -> None:
        assert not self.left, f"the host never said {self.left[0][0]!r}"


def second_pair(polls: int = 1) -> Mount:
    """A mount whose x is axis 4, on a board that is asked for its status so many times."""
    status = "|".join(["7,100,0", *(f"{number}000,0,0,0,1,1" for number in range(1, 5))])
    port = TranscriptPort([("!", None), ("*IDN?", IDENTITY), *[("XS?", status)] * polls])
    return Mount(Link(port), x_axis=4)


def opened(lines: list[tuple[str, str | None]]) -> Mount:
    """A mount at whose port these lines are to be heard, after those of the opening."""
    return Mount(Link(TranscriptPort([("!", None), ("*IDN?", IDENTITY), ("XS?", AT_REST), *lines])))


def sent(line: str, answer: str = "", error: str = NO_ERROR) -> list[tuple[str, str | None]]:
    """One line of Mount.send(), after a look for old errors."""
    return [("XS?", AT_REST), (f"{line};TB?", f"{answer}; {error}" if answer else error)]


def started(line: str) -> list[tuple[str, str | None]]:
    """A line that starts a motion, under a keep-alive."""
    return sent(f"XK500;{line}")
