"""Runs every test of this folder on a MicroPython VM:  micropython run_micropython.py FIRMWARE_DIR

Prints a line per failure and a last line "N passed, N failed"; exit status 1 if any failed.
"""

import sys

TESTS = (
    "test_wire",
    "test_stops",
    "test_motion",
    "test_backlash",
    "test_homing",
    "test_emergency",
    "test_memory",
    "test_settings",
    "test_recorded",
)


class NoTicks:
    """Stands for `time`: the Unix VM's own ticks wrap at 2**62, a board's at 2**30 (ticks.py has both)."""


folder = __file__.rsplit("/", 1)[0] if "/" in __file__ else "."
sys.path[:0] = [folder, sys.argv[1]]
sys.modules["time"] = NoTicks()

passed = failed = 0
for module_name in TESTS:
    module = __import__(module_name)
    for name in sorted(dir(module)):
        if name.startswith("test_"):
            try:
                getattr(module, name)()
                passed += 1
            except Exception as e:
                failed += 1
                print("FAILED", module_name, name)
                sys.print_exception(e)
print("%d passed, %d failed" % (passed, failed))
sys.exit(1 if failed else 0)
