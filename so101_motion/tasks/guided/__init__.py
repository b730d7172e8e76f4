"""Guided paths: recorded while a hand guides the arm, saved and replayed."""

from so101_motion.tasks.guided.path import GuidedPath, tool_line
from so101_motion.tasks.guided.recorder import PathRecorder
from so101_motion.tasks.guided.replay import Replay, plan_replay, start_replay

__all__ = ["GuidedPath", "PathRecorder", "Replay", "plan_replay", "start_replay", "tool_line"]
