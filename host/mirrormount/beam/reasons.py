"""Why there is no spot: one declaration of each reason, with the words for people."""

from enum import Enum


class Reason(Enum):
    """A reason. words: cause and remedy."""

    def __init__(self, code: str, cause: str, remedy: str) -> None:
        self.code = code
        self.cause = cause
        self.remedy = remedy

    @property
    def words(self) -> str:
        return f"{self.cause}; {self.remedy}"

    FLAT = ("flat", "all pixels have one value", "remove the lens cap, or change the exposure")
    NOTHING = (
        "nothing",
        "nothing is brighter than the background and its noise",
        "switch on the laser, point the camera at the spot, or expose for longer",
    )
    DIM = (
        "dim",
        "the spot is too dim: its place, or a second one, is not known",
        "expose for longer, or darken the room",
    )
    SATURATED = ("saturated", "too many pixels are saturated", "expose for a shorter time, or weaken the beam")
    SPLIT = ("split", "two spots are nearly equally bright", "cover reflections, so that one spot is left")
    EDGE = ("edge", "the spot is cut by the picture's edge", "turn the camera, or move the beam")
    SMALL = (
        "small",
        "the bright place is smaller than a spot, as a hot pixel is",
        "defocus a little, or give a dark frame",
    )
    WIDE = ("wide", "the bright place is larger than a spot, as a lamp is", "focus the spot, or shade the lamp")
    SHAPE = (
        "shape",
        "the bright place has not the shape of a spot",
        "look for something in the beam's way, stray light, or a moving beam",
    )


# that the noise of a good spot looks like in one frame of some hundred: no single frame says it for sure
BY_CHANCE = frozenset({Reason.SHAPE, Reason.SPLIT, Reason.DIM})
