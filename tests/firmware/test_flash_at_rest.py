"""Flash is never written while anything drives: interrupts are off meanwhile, so nothing would cut (docs/gate.md)."""

import random

from rig import START_US, Port, Rig

ENABLES = (2, 5)
WORDS = (
    (b"SM\n", b"XX\n", b"*RCL1\n", b"*RST\n", b"1DH5\n", b"2DH;SM\n", b"XF?\n")  # they read or write files
    + (b"1PR2\n", b"2PA-1;1PR1\n", b"1MV+;SM\n", b"2MV-\n", b"1XU900\n", b"02550255", b"-1000000", b"0255")
    + (b"!", b"00000000", b"1ST\n", b"XS?\n")
)


class Watched(Port):
    """A port that notes each change of a file, and which of them found a motor with drive, before or after it."""

    def __init__(self):
        super().__init__({})
        self.changes, self.driven = 0, []

    def _change(self, what, name, action, *arguments):
        before = any(self.pins.get(pin) for pin in ENABLES)
        super()._change(what, name, action, *arguments)
        self.changes += 1
        if before or any(self.pins.get(pin) for pin in ENABLES):
            self.driven.append((self.us - START_US, what, name))


def test_no_file_changes_while_a_motor_has_drive():
    chosen = random.Random(14)
    changes = drives = 0
    for session in range(60):
        rig = Rig(port=Watched())
        rig.send(b"1XM40000;2XM40000\n")
        for _ in range(25):
            rig.send(chosen.choice(WORDS), after_us=chosen.choice((0, 900, 30_000)), gap_us=chosen.choice((0, 90)))
            if chosen.randrange(6) == 0:
                rig.send(chosen.choice((b"!", b"\n1MV-\n")))
                rig.run(11_000_000)  # if all has rested so long, the positions are recorded
            else:
                rig.run(chosen.choice((200, 20_000, 120_000)))
        assert rig.port.driven == [], session
        changes += rig.port.changes
        drives += sum(1 for _, pin, duty in rig.port.edges if pin in ENABLES and duty)
    assert changes > 300 and drives > 300
