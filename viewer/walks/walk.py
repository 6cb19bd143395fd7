"""Walks have moved to :mod:`mmi.walks.walk`, since builds read them as well; this name goes when its last user has followed."""

from mmi.walks.walk import Keyframe, Pose, Step, Walk, read_walk, write_walk

__all__ = ["Keyframe", "Pose", "Step", "Walk", "read_walk", "write_walk"]
