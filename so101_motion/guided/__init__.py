"""A path that a hand has shown: taken down while the arm is guided, kept in a file, gone again.

``path.py`` is the path and what is left of it within a tolerance, ``recorder.py`` takes it down,
``files.py`` keeps it, ``replay.py`` plans it anew under the arm's own caps, ``run.py`` runs that.
"""

from so101_motion.guided.path import GuidedPath
from so101_motion.guided.recorder import PathRecorder
from so101_motion.guided.replay import Replay, plan_replay
from so101_motion.guided.run import start_replay

__all__ = ["GuidedPath", "PathRecorder", "Replay", "plan_replay", "start_replay"]
