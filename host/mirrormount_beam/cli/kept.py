"""The spot that a camera sees, for `mirrormount keep` and `back` with --camera (docs/presets.md)."""

import argparse
from collections.abc import Callable
from typing import Self

from mirrormount.cli.arguments import camera_settings, note
from mirrormount.device.mount import Mount
from mirrormount.device.presets import Preset, SeenSpot
from mirrormount_beam import kept
from mirrormount_beam import scale as camera_scale
from mirrormount_beam.cameras import open_beside_mount
from mirrormount_beam.observe import SpotObserver
from mirrormount_beam.scale import Optics


class KeptSpot:
    """The spot of the arguments' camera, beside an open mount. Use `with`. Raises what open_beside_mount() raises."""

    def __init__(self, mount: Mount, args: argparse.Namespace) -> None:
        self._mount = mount
        self._camera = open_beside_mount(args.camera, camera_settings(args))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._camera.close()

    def seen(self) -> SeenSpot:
        """Where it is now. Raises SpotLost, CameraError."""
        return kept.seen(SpotObserver(self._camera))

    def check(self, preset: Preset) -> None:
        """Raises CannotCompare if it cannot be brought back with this camera."""
        kept.comparable(preset.name, preset.spot, self._camera)

    def bring(self, preset: Preset, say: Callable[[str], object]) -> str:
        """Bring it to where it was kept. Returns how far off it is, in words. Raises as kept.bring()."""
        arrival = kept.bring(self._mount, self._camera, preset, say)
        assert preset.spot
        return kept.off(preset.spot, arrival, Optics(camera_scale.read_if_any(self._camera, note)))
