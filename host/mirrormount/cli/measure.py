"""`mirrormount measure`: experiments of a mount in front of a camera, by measure_work.py."""

import argparse
from pathlib import Path

from mirrormount.cli.command import Command, from_extra, mount_and_camera

EXPERIMENTS = ("steps", "backlash", "pulses", "square", "drift", "settle")


def arguments(parser: argparse.ArgumentParser) -> None:
    """The experiment, mount, camera and scale; where the report goes."""
    parser.add_argument("experiment", choices=EXPERIMENTS, help="docs/measure.md says what each of them does")
    mount_and_camera(parser)
    parser.add_argument(
        "--encoder", choices=("motor", "shaft"), help="virtual: an encoder on each motor, or behind it; closed loop"
    )
    parser.add_argument("--axes", default="x,y", metavar="LIST", help="axes to measure, such as x or x,y")
    parser.add_argument("--mm-per-px", metavar="MM", help="mm at the camera for one pixel")
    parser.add_argument("--mm-per-px-error", metavar="MM", help="its standard error (0)")
    parser.add_argument("--distance", metavar="MM", help="from the mirror to the camera's plane, along the beam")
    parser.add_argument("--distance-error", metavar="MM", help="its standard error (0)")
    parser.add_argument("--incidence", metavar="DEGREES", help="between beam and mirror's normal (45)")
    parser.add_argument("--minutes", metavar="M", help="drift: how long (60)")
    parser.add_argument(
        "--step",
        nargs=2,
        metavar=("SIZE", "UNIT"),
        help="steps: find the pulse for a step of this size: px, mm, urad, mrad (of the mirror), beam-urad, beam-mrad",
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="the page (default: measure-EXPERIMENT.html)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all numbers (default: beside the page)")
    parser.add_argument(
        "--apply", action="store_true", help="save what was measured: scales, or take-up or step on the board"
    )


def run(args: argparse.Namespace) -> None:
    """Measure and write the report. Raises MountError."""
    with from_extra("camera,plot", "measuring needs"):
        from mirrormount.cli.measure_work import measure
    measure(args)


COMMANDS = (
    Command("measure", "measure steps, backlash, pulses, square, drift or settling with a camera", run, arguments),
)
