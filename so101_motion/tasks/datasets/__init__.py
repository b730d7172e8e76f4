"""Check, convert and replay LeRobot data sets of an SO-101 (versions 2.0 to 3).

``replay.py`` is imported by who replays: it brings the whole arm with it.
"""

from so101_motion.tasks.datasets.check import CheckReport, check_data_set
from so101_motion.tasks.datasets.convert import Conversion, convert_data_set
from so101_motion.tasks.datasets.data_set import DataSet, Episode, open_data_set
from so101_motion.tasks.datasets.html_report import html_report
from so101_motion.tasks.datasets.moments import Moment
from so101_motion.tasks.datasets.units import Units, units_of

__all__ = [
    "CheckReport",
    "Conversion",
    "DataSet",
    "Episode",
    "Moment",
    "Units",
    "check_data_set",
    "convert_data_set",
    "html_report",
    "open_data_set",
    "units_of",
]
