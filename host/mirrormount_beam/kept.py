"""Where the spot was at a kept position, and the way back to it by the camera.

mount.presets.keep("good", spot=kept.seen(SpotObserver(camera)))
mount.presets.back("good")                              # by steps: the backlash hides the place
arrival = kept.bring(mount, camera, mount.presets.get("good"))  # by the picture, within WITHIN_PX
"""

from mirrormount.device.mount import Mount
from mirrormount.device.presets import Preset, SeenSpot
from mirrormount_beam.camera import Camera, Size
from mirrormount_beam.errors import CannotCompare, NotMeasurable
from mirrormount_beam.estimates import Estimate
from mirrormount_beam.experiments.rig import MountRig
from mirrormount_beam.observe import FRAMES, FrameSource, SpotObserver
from mirrormount_beam.pointing import Arrival, Say, approach, learn
from mirrormount_beam.scale import Optics


def seen(observer: SpotObserver) -> SeenSpot:
    """Where the spot is now, from FRAMES images. Raises SpotLost, CameraError."""
    place, camera = observer.observe(FRAMES), observer.camera
    return SeenSpot(camera.name, place.x, place.y, place.error_x, place.error_y, *camera.size)


def comparable(name: str, spot: SeenSpot | None, camera: FrameSource) -> SeenSpot:
    """The spot of the position of that name, if this camera can find its place again. Raises CannotCompare."""
    if spot is None:
        raise CannotCompare(f"{name} was kept without a spot: go by steps only, or keep it again with a camera")
    if spot.camera != camera.name:
        raise CannotCompare(f"{name} was kept with the camera {spot.camera}, and this one is {camera.name}")
    if Size(spot.width, spot.height) != camera.size:
        was = Size(spot.width, spot.height)
        raise CannotCompare(f"{name} was kept in a picture of {was} pixels, and the camera has {camera.size}")
    return spot


def bring(mount: Mount, camera: Camera, preset: Preset, say: Say = str) -> Arrival:
    """Bring the spot to where it was kept: 3 to 8 steps of x and y to learn what they do, then small corrections.

    The mount is near the place already (Presets.back()). say: gets what it does, in lines. Raises CannotCompare,
    SpotLost, CameraError, NotMeasurable (also if the spot does not arrive), and what Axis.step() raises.
    """
    spot = comparable(preset.name, preset.spot, camera)
    rig = MountRig(mount, SpotObserver(camera))
    with mount.unless_stopped():
        learned = learn(rig, ("x", "y"), say)
        arrival = approach(rig, learned, (spot.x, spot.y), say)
    if not arrival.reached:
        raise NotMeasurable(f"{preset.name}: after {arrival.corrections} corrections {off(spot, arrival)}")
    return arrival


def off(spot: SeenSpot, arrival: Arrival, optics: Optics | None = None) -> str:
    """How far the spot is from where it was kept, in words: px, and what the scale knows beside them."""
    now, error = arrival.sighting, 0.0
    if arrival.off_px:
        right, down = (now.x - spot.x) / arrival.off_px, (now.y - spot.y) / arrival.off_px
        errors = (right * spot.error_x, right * now.error_x, down * spot.error_y, down * now.error_y)
        error = sum(each**2 for each in errors) ** 0.5
    px = Estimate(arrival.off_px, error, "px")
    known = optics or Optics()
    length, angle = known.mm(px), known.beam_urad(px)
    more = [str(length.scaled(1000, "um"))] if length else []
    more += [f"{angle} of the beam"] if angle else []
    return f"the spot is {px} from where it was kept" + (f" ({', '.join(more)})" if more else "")
