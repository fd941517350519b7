"""Processor time of a pair of frames, two cameras of 640 x 480, through camera, spot and a correction of 4 axes.

usage: pair.py [--pairs 150] [--profile rough] [--colour]

Pictures are rendered before, by the virtual table's sensor. Not included: the driver that fills the buffers, and the
decoding of a webcam's JPEG, which some cameras need (about 1 ms a frame).
"""

import argparse
import time

import _paths  # noqa: F401
import numpy as np

from mirrormount.beam import find_spot
from mirrormount.beam.camera import Size
from mirrormount.beam.checked import Limits, Picture, checked
from mirrormount.transport.open import open_table

_DIFFERENT = 40  # pictures of each camera, again and again
_DAMPING = 0.05  # Tikhonov, of the largest singular value


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description="processor time of a pair of frames")
    parser.add_argument("--pairs", type=int, default=150)
    parser.add_argument("--profile", choices=("smooth", "rough"), default="rough")
    parser.add_argument("--colour", action="store_true", help="pictures of three channels, as webcams deliver them")
    args = parser.parse_args()
    table = open_table(f"virtual-table://?profile={args.profile}&seed=7&off=3")
    try:
        some = [_pictures(camera, args.colour) for camera in table.cameras]
    finally:
        table.close()
    streams = [checked(_again(each), "bench", Size(640, 480), Limits()) for each in some]
    response = np.random.default_rng(1).normal(size=(4, 4))
    parts = np.zeros(3)
    answered = 0
    for _ in range(args.pairs):
        begin = time.process_time()
        frames = [next(stream) for stream in streams]
        seen = time.process_time()
        spots = [find_spot(frame) for frame in frames]
        found = time.process_time()
        places = [place for spot in spots if spot for place in (spot.x, spot.y)]
        if len(places) == len(response):
            answered += 1
            _correction(response, np.array(places))
        parts += np.diff([begin, seen, found, time.process_time()])
    ms = 1e3 * parts / args.pairs
    print(f"{args.profile}{', colour' if args.colour else ''}: {args.pairs} pairs, {answered} with both spots")
    print(f"  ms of processor time a pair: {ms.sum():.1f} (camera {ms[0]:.1f}, spot {ms[1]:.1f}, loop {ms[2]:.2f})")
    print(f"  pairs a second: {1e3 / ms.sum():.0f} on one core, {2e3 / ms.sum():.0f} on two")


def _pictures(camera, colour):
    frames = camera.frames()
    images = [next(frames).image for _ in range(_DIFFERENT)]
    return [np.repeat(image[:, :, None], 3, axis=2) if colour else image for image in images]


def _again(images):
    at = 0
    while True:
        yield Picture(images[at % len(images)], at / 30)
        at += 1


def _correction(response, places):
    u, s, v = np.linalg.svd(response)
    return v.T @ (s / (s**2 + (_DAMPING * s[0]) ** 2) * (u.T @ places))


if __name__ == "__main__":
    main()
