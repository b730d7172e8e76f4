import pytest
from so101_viewer.page import texts
from so101_viewer.page.screen_state import Tone

from so101_motion.common.errors import ConfigError, Interrupted
from so101_motion.common.modes import Mode


def test_every_mode_has_words():
    assert set(texts._MODES) == set(Mode)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (Interrupted("stop"), "Stopped. The arm holds where it is."),
        (
            Interrupted("a newer motion"),
            "Ended early by a newer motion. The arm holds where it is.",
        ),
        (ConfigError("pose name", "", "type a name first"), "Type a name first."),
        (ConfigError("pose name", "home", "is built in"), "'home' is built in."),
        (ConfigError("speed", 999, "must be less"), '"speed" = 999: must be less.'),
    ],
)
def test_an_end_before_the_goal_is_reported_in_one_sentence(error, text):
    said = texts.ended(error)
    assert said.text == text
    assert (said.tone is Tone.BAD) is isinstance(error, ConfigError)
