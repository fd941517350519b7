"""A rig whose positions are recorded. For the tests of records."""

from rig import Rig

FILE = "mountfw.position"
REST_US = 10_000_000
RECORDED_US = 10_700_000  # by then the record is in place
KNOWN = ("millisteps", "certainty", "target", "defined", "home_known", "home", "gap_known", "inside")
MOTIONS = (
    b"1PR1\n",
    b"2PR-1\n",
    b"1PA0\n",
    b"2MV+\n",
    b"1MV-\n",
    b"02550000",
    b"00000001",
    b"-255-255",
    b"1PR1;2PR1\n",
)


def restart(rig):
    """Power off and on; what is on the flash stays."""
    return Rig(rig.board, dict(rig.port.files))


def known(rig):
    """All that outlives a restart, of both axes."""
    return [getattr(axis.position, name) for axis in (rig.axis1, rig.axis2) for name in KNOWN]


def certainty(rig):
    return (rig.axis1.position.certainty, rig.axis2.position.certainty)


def recorded(setup=b"", rig=None):
    """A rig whose axes stand at 13 and -5, counted and recorded."""
    rig = rig or Rig()
    rig.ask(setup)
    rig.ask(b"1VA4;2VA4;1DH10;2DH-3;1PR3;2PR-2\n")
    rig.run(1_000_000)
    rig.run(RECORDED_US)
    assert FILE in rig.port.files
    return rig


def rises(rig):
    """When the pins that were low rose."""
    return [us for us, _, duty in rig.port.edges if duty]
