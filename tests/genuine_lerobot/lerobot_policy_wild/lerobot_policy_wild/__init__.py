"""A LeRobot policy that has learnt nothing: waves in chunks that come late, or garbage."""

from .configuration_wild import WildConfig

__all__ = ["WildConfig"]
