"""The beam, seen by cameras: frames, the spot in them, and its scale in millimetres and milliradians."""
