from __future__ import annotations

import pytest
from so101_viewer import words
from so101_viewer.screen import Tone

from so101_motion.errors import ConfigError, Interrupted
from so101_motion.modes import Mode


def test_every_mode_has_words() -> None:
    assert set(words._MODES) == set(Mode)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (Interrupted("stop"), "Stopped. The arm holds where it is."),
        (
            Interrupted("a newer motion"),
            "Ended early by a newer motion. The arm holds where it is.",
        ),
        (ConfigError("speed", 999, "must be less"), '"speed" = 999: must be less.'),
    ],
)
def test_an_end_before_the_goal_is_told_in_one_sentence(error: Exception, text: str) -> None:
    assert words.ended(error).text == text


def test_only_a_stop_on_purpose_is_not_bad_news() -> None:
    assert words.ended(Interrupted("stop")).tone is Tone.PLAIN
    assert words.ended(ConfigError("a", 1, "b")).tone is Tone.BAD


def test_the_distance_from_the_target_is_told_in_millimetres() -> None:
    assert words.arrived(0.00012).text.startswith("Arrived, 0.1 mm off")
