"""One file a board: its pins, its bridge, and the constants that go with them. What all of them have is named here."""

AXES = ("AXIS_1", "AXIS_2", "AXIS_3", "AXIS_4")  # as many as the dialect knows; the first two are required
DRIVES = ("en", "pos", "neg")  # the pins of an axis that drive


def axes(board):
    """The pins of each axis of a board file, in the order of their numbers."""
    return [getattr(board, name) for name in AXES if hasattr(board, name)]
