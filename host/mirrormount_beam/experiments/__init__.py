"""The experiments of `mirrormount measure`: each moves a rig, observes the spot, and returns a Result."""
