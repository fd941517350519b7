"""Plans of Bluesky for mounts and the spot in a camera. Positions in steps, spots in px."""

import math

import bluesky.plan_stubs as bps
import bluesky.plans as bp
import bluesky.preprocessors as bpp

APPROACH = 4  # steps: more than the gap of a hobby gearmotor


def align(spot, x, y, target, reach=4, num=5):
    """Look at a grid of num x num places around, and go to the one whose spot is nearest to target (x, y)."""
    seen = []

    def look(detectors, step, pos_cache):
        yield from bps.move_per_step(step, pos_cache)
        reading = yield from bps.trigger_and_read([*detectors, *step])
        if reading[spot.found.name]["value"]:
            seen.append({name: read["value"] for name, read in reading.items()})

    yield from bp.rel_grid_scan([spot], y, -reach, reach, num, x, -reach, reach, num, per_step=look)
    if not seen:
        raise RuntimeError("no place of the grid has a spot")
    best = min(seen, key=lambda row: math.dist((row[spot.x.name], row[spot.y.name]), target))
    yield from bps.mv(x, best[x.name] - APPROACH, y, best[y.name] - APPROACH)  # from the side as in the grid
    yield from bps.mv(x, best[x.name], y, best[y.name])
    return best


def spiral(reach, pitch):
    """Places of a square spiral, from (0, 0) outwards."""
    yield 0, 0
    for ring in range(pitch, reach + 1, pitch):
        side = range(-ring, ring, pitch)
        yield from ((ring, along) for along in side)
        yield from ((-along, ring) for along in side)
        yield from ((-ring, -along) for along in side)
        yield from ((along, -ring) for along in side)


def spiral_search(spot, x, y, reach=10, pitch=2):
    """Go outwards in a square spiral until the camera sees a spot. Returns True then; else it is back at the start."""

    found = False

    @bpp.stage_decorator([spot, x, y])
    @bpp.run_decorator()  # it returns the run's uid, whatever the plan returns
    def search():
        nonlocal found
        x0 = yield from bps.rd(x)
        y0 = yield from bps.rd(y)
        for dx, dy in spiral(reach, pitch):
            yield from bps.mv(x, x0 + dx, y, y0 + dy)
            yield from bps.trigger_and_read([spot, x, y])
            found = bool((yield from bps.rd(spot.found)))
            if found:
                return
        yield from bps.mv(x, x0, y, y0)

    yield from search()
    return found


def walk(spot, first, second, reach=4, num=5):
    """Move an axis of two mounts against each other, and look at each place: where the beam is, at another angle."""
    yield from bp.rel_scan([spot], first, -reach, reach, second, reach, -reach, num)
