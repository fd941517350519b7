"""Runs every test of this folder on a MicroPython VM:  micropython run_micropython.py FIRMWARE_DIR

With a second argument "quick", some of them, none that takes long: WebAssembly builds are slow, and there are many.
With the name of a module, those of it: test_encoder_cuts keeps too many files for the heap of the others.
With a second argument, the folder …/virtual/fakes, and a third, the folder of adafruit_motor: those that both ports
pass, on the CircuitPython port and the fakes of its modules; then on CPython, too.
Prints a line per failure and a last line "N passed, N failed"; exit status 1 if any failed.
"""

import sys

TESTS = (
    "test_wire",
    "test_health",
    "test_power",
    "test_returned",
    "test_dialect",
    "test_board_file",
    "test_stops",
    "test_lane",
    "test_frame_in_parts",
    "test_axes",
    "test_motion",
    "test_decay",
    "test_end_stops",
    "test_keep_alive",
    "test_axis_table",
    "test_own_length",
    "test_backlash",
    "test_homing",
    "test_emergency",
    "test_encoder_counts",
    "test_encoder_frames",
    "test_encoder_records",
    "test_encoder_settings",
    "test_counted_moves",
    "test_encoder_faults",
    "test_memory",
    "test_settings",
    "test_recorded",
    "test_record_faults",
    "test_nvm_files",
)

QUICK = ("test_settings", "test_backlash")
# (not test_memory: these builds have the small integers of 31 bits, so the rig's own clock would allocate)
# left out of them: one motion or file again and again, with something that happens at each of its instants
LONG = (
    "test_a_file_with_any_byte_changed_gives_the_settings_as_made_and_error_63",
    "test_a_file_cut_at_any_length_gives_the_settings_as_made_and_error_63",
)
ON_BOTH_PORTS = (
    "test_wire",
    "test_health",
    "test_stops",
    "test_motion",
    "test_end_stops",
    "test_keep_alive",
    "test_memory",
)
# these ask for what the CircuitPython port has not: times to 0.1 ms, where its clock has steps of 1 ms; both motors at
# once, where each start waits for such a step; an enable that is low at once, where it waits for the PWM's period
NOT_ON_CIRCUITPYTHON = (
    "test_both_motors_change_in_one_pass",
    "test_health_is_memory_longest_pass_passes_and_cause_of_the_reset",
    "test_the_longest_pass_is_of_the_time_since_one_asked_and_does_not_count_waiting",
    "test_a_stop_that_comes_while_a_frame_is_counted_leaves_its_drive_counted",
    "test_soft_stop_finishes_a_pulse_that_is_nearly_over_and_nothing_else",
    "test_a_byte_that_comes_just_before_the_end_keeps_a_motion_alive",
    "test_a_burst_of_input_does_not_hold_up_the_end_of_a_pulse",
    "test_a_run_ends_at_its_limit_and_says_so",
    "test_a_short_keep_alive_is_kept_to",
    "test_a_step_is_one_pulse_of_its_length_and_steps_keep_their_period",
    "test_a_switch_that_opens_shortly_before_a_pulse_ends_cuts_it_without_an_interrupt",
    "test_pulse_length_duty_and_velocity_are_the_axis_own",
    "test_steps_that_cannot_be_as_fast_as_set_are_as_fast_as_the_pulses_allow",
    "test_the_enable_drops_before_a_leg_changes_and_rises_after_the_dead_time",
)


class NoTicks:
    """Stands for `time`: the Unix VM's own ticks wrap at 2**62, a board's at 2**30 (ticks.py has both)."""


if sys.implementation.name == "cpython":
    from traceback import print_exception as show
else:
    show = sys.print_exception

folder = __file__.rsplit("/", 1)[0] if "/" in __file__ else "."
sys.path[:0] = [folder, sys.argv[1]]
sys.modules["time"] = NoTicks()
left_out = ()
if sys.argv[2:] == ["quick"]:
    TESTS = QUICK
    left_out = LONG
elif len(sys.argv) == 3 and sys.argv[2].startswith("test_"):
    TESTS = (sys.argv[2],)
elif len(sys.argv) > 2:
    import rig_circuitpython

    rig_circuitpython.use(sys.argv[2])
    sys.path[2:2] = sys.argv[3:4]  # where adafruit_motor is
    TESTS = ON_BOTH_PORTS
    left_out = NOT_ON_CIRCUITPYTHON

passed = failed = 0
for module_name in TESTS:
    module = __import__(module_name)
    for name in sorted(dir(module)):
        if name.startswith("test_") and name not in left_out:
            try:
                getattr(module, name)()
                passed += 1
            except Exception as e:
                failed += 1
                print("FAILED", module_name, name)
                show(e)
print("%d passed, %d failed" % (passed, failed))
sys.exit(1 if failed else 0)
