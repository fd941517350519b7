"""How the virtual Pico is wired to the bench: GPIO number to the name of the wire.

It is the wiring table of docs/bring-up.md, written down here a second time on purpose: the
bench must not learn from the firmware what the firmware should have driven.
"""

DRIVES = {
    2: "m1_en",
    3: "m1_pos",
    4: "m1_neg",
    5: "m2_en",
    6: "m2_pos",
    7: "m2_neg",
}
MORE_DRIVES = {  # of a board with four axes
    16: "m3_en",
    17: "m3_pos",
    18: "m3_neg",
    19: "m4_en",
    20: "m4_pos",
    21: "m4_neg",
}
LED = 25
SWITCHES = {
    10: "m1_sw_pos",
    11: "m1_sw_neg",
    12: "m2_sw_pos",
    13: "m2_sw_neg",
    14: "emergency_stop",
}
ENCODERS = {  # motor: A and B of a quadrature encoder, or SDA and SCL of one on the output shaft
    "m1": (8, 9),
    "m2": (26, 27),
}
BUS = 64  # a change of the angle on the bus whose SDA is GPIO n is told as one of wire 64 + n


def drives(axes: int) -> dict[int, str]:
    """The wires to the H-bridges of a board with two axes, or four."""
    return DRIVES | MORE_DRIVES if axes > 2 else DRIVES
