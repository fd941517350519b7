"""The secret that a client of a wider network must have: read, judged and compared. `serve` and the panel use it.

token = read_token(args.token, args.token_file)   # None: there is none
if is_short(token): ...                           # say so in one line: SHORT
if guesses.wait_s(peer) == 0 and same(line, token): ...
else: guesses.wrong(peer)
"""

import hmac
import math
import os
import time
from collections.abc import Callable
from pathlib import Path

from mirrormount.common.errors import BadValue

LONGEST = 254  # characters
BITS = 128  # what cannot be guessed by trying, however fast
SHORT = f"the token can be guessed (less than {BITS} bits): take one of `secrets.token_urlsafe()`"

_FREE = 5  # wrong guesses of one address within _FORGET_S that cost no time: typing errors
_FORGET_S = 60.0
_PAUSE_S = 1.0  # between two guesses after those
_ADDRESSES_MOST = 1000  # that are remembered
_UNSEEN = 3  # bits: of 128 as 22 characters of base64 one text in a hundred has no digit, and seems to hold less
_FEW = 8  # different characters: a token with fewer is a pattern, however long
_KINDS = ((str.islower, 26), (str.isupper, 26), (str.isdecimal, 10), (lambda c: not c.isalnum(), 33))


def read_token(given: str | None, file: Path | None = None) -> bytes | None:
    """The token as it goes over the wire: as given, else the first line of file, else $MIRRORMOUNT_TOKEN.

    None if there is none. Raises BadValue for one that cannot be a token.
    """
    if given is not None and file is not None:
        raise BadValue("--token and --token-file: give one of them")
    if file is not None:
        try:
            with file.open(encoding="ascii") as opened:
                given = opened.readline(LONGEST + 2).rstrip("\r\n")
        except (OSError, UnicodeDecodeError) as e:
            why = e.strerror if isinstance(e, OSError) else "not ASCII"
            raise BadValue(f"--token-file {file}: cannot be read: {why}") from e
    return check_token(given if given is not None else os.environ.get("MIRRORMOUNT_TOKEN") or None)


def check_token(token: str | None) -> bytes | None:
    """A token as it goes over the wire. Raises BadValue for one that cannot."""
    if token is None:
        return None
    if not (token.isascii() and token.isprintable() and token.strip() == token and 0 < len(token) <= LONGEST):
        raise BadValue(f"a token is 1 to {LONGEST} printable ASCII characters, with no space at either end")
    return token.encode()


def is_short(token: bytes | None) -> bool:
    """True if token, taken as random, holds less than BITS bits, but for _UNSEEN; or is a pattern of few characters."""
    if token is None:
        return False
    text = token.decode("ascii")
    alphabet = sum(size for belongs, size in _KINDS if any(belongs(c) for c in text))
    return len(text) * math.log2(alphabet) < BITS - _UNSEEN or len(set(text)) < _FEW


def same(given: bytes, token: bytes) -> bool:
    """Are they equal? Takes as long for any wrong one of that length."""
    return hmac.compare_digest(given, token)


class Guesses:
    """Slows down who tries tokens: five wrong ones a minute are free, then one a second for each address.

    An address is what the peer cannot choose freely: an IP address without its port.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._wrong: dict[str, list[float]] = {}  # when, the last ones

    def wait_s(self, address: str) -> float:
        """How long until a guess from address may be compared; 0: now."""
        wrong = self._wrong.get(address, [])
        now = self._clock()
        if len([at for at in wrong if now - at < _FORGET_S]) < _FREE:
            return 0.0
        return max(0.0, wrong[-1] + _PAUSE_S - now)

    def wrong(self, address: str) -> None:
        """A guess from address was compared, and was wrong."""
        wrong = self._wrong.pop(address, [])
        self._wrong[address] = [*wrong[1 - _FREE :], self._clock()]
        if len(self._wrong) > _ADDRESSES_MOST:
            del self._wrong[next(iter(self._wrong))]  # the one that guessed longest ago
