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
LED = 25
SWITCHES = {
    10: "m1_sw_pos",
    11: "m1_sw_neg",
    12: "m2_sw_pos",
    13: "m2_sw_neg",
    14: "emergency_stop",
}
