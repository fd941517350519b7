"""The experiments of `mirrormount measure`: each moves a rig, looks, and returns a Result."""
