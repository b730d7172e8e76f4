"""Policies that have learnt nothing: waves in chunks that come late, or garbage."""

from .configuration_wild import WildConfig

__all__ = ["WildConfig"]
