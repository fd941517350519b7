"""The firmware's files on a board as 0.1.0 deployed them: all modules in one folder, board files in another."""

_BOTH = (
    *("__init__", "answers", "app", "axis", "bridge", "command", "commands", "controller", "endstop", "errors"),
    *("frame", "homing", "link", "parameters", "position", "repl", "room", "settings", "ticks"),
    *("boards/__init__", "boards/adafruit_feather_esp32s3", "boards/adafruit_feather_rp2040"),
    *("boards/pico", "boards/pico_drv8833"),
)
_OF_A_PORT = {
    "micropython": ("console_micropython", "port_micropython"),
    "circuitpython": tuple(f"{name}_circuitpython" for name in ("console", "files", "nvm", "pins", "port")),
}


def flat(platform: str, suffix: str = ".py") -> dict[str, bytes]:
    """{path: stand-in content} of the modules of 0.1.0; the programs in the root are the test's."""
    names = (*_BOTH, *_OF_A_PORT[platform])
    return {f"mountfw/{name}{suffix}": f"# {name} of 0.1.0\n".encode() for name in names}
