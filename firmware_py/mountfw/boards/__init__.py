"""One file a board: its pins, its bridge, and the constants that go with them."""

# The file for a board, by the names that the platforms give it: CircuitPython's board id, and MicroPython's
# MICROPY_HW_BOARD_NAME in small letters, with _ for what is neither letter nor digit. The file of a board that is not
# here has the board's name.
FILE_OF = {
    "raspberry_pi_pico": "pico",
    "raspberry_pi_pico_w": "pico_w",
    "raspberry_pi_pico2": "pico2",
    "raspberry_pi_pico2_w": "pico2_w",
    "raspberry_pi_pico_2_w": "pico2_w",
    "seeed_studio_xiao_rp2040": "seeed_xiao_rp2040",
    "seeeduino_xiao_rp2040": "seeed_xiao_rp2040",
    "adafruit_feather_esp32s3_4mbflash_2mbpsram": "adafruit_feather_esp32s3",
    "adafruit_feather_esp32s3_nopsram": "adafruit_feather_esp32s3",
}
