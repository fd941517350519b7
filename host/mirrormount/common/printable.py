"""Text from outside (a board, a drive, a file, a network), made safe to print. Imports nothing."""


def printable(text: str, longest: int = 200) -> str:
    r"""One line in which nothing controls a terminal: other characters appear as escapes, for instance `\x1b`.

    Control characters, line breaks, marks that turn the direction of text and unpaired surrogates are escaped.
    A text of more than `longest` characters ends in an ellipsis.
    """
    kept = text if len(text) <= longest else text[: longest - 1] + "…"
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode("ascii") for c in kept)
