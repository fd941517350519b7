"""The lines by which a program that serves a board refuses a client. Imports nothing."""

TAKEN = "mirrormount: this board has a client already"
NO_BOARD = "mirrormount: the board is not there"
AT_PROMPT = "mirrormount: the board is at its Python prompt, which is not served on TCP"
TOKEN_REFUSED = "mirrormount: the first line must be the token"


def refusal_line(text: str) -> bytes:
    """A refusal as it goes over the wire."""
    return text.encode() + b"\r\n"
