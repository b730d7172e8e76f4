import json
from dataclasses import replace

import pytest
from harness.fake_page import STILL
from so101_viewer.page import cards, markup, texts
from so101_viewer.page.bar import Bar
from so101_viewer.page.screen_state import Sentence, Tone

from so101_motion.common.errors import ConfigError, Interrupted
from so101_motion.common.modes import Mode
from so101_motion.common.operation import Row

EVIL = '<img src=x onerror="move()">'


@pytest.mark.parametrize(
    "html",
    [
        markup.sentence(Sentence(text=EVIL, tone=Tone.BAD)),
        markup.headline(EVIL, EVIL, is_under_way=True),
        markup.facts([(EVIL, EVIL)]),
        markup.to_copy(EVIL, EVIL),
        markup.gauge(EVIL, 1.0, 0.0, 2.0, unit=EVIL),
        cards.rows((EVIL,), (Row(label=EVIL, cells=(EVIL,), text=EVIL, tone="warm", mark=EVIL),)),
        cards.instruction(EVIL, EVIL),
        cards.failed(EVIL),
    ],
)
def test_text_from_outside_never_becomes_markup(html):
    assert "<img" not in html
    assert "&lt;img src=x onerror=&quot;move()&quot;&gt;" in html


def test_only_what_was_given_as_one_is_called_a_thing_to_do():
    lost = cards.failed("Lost the arm. It reconnects by itself; nothing moves.")
    assert "<div>Nothing moves.</div>" in lost
    assert "<b>Do this:</b> Plug it in." in cards.marked("✗", "bad", "it is gone", "plug it in")


def gauge(value, *, warns=True):
    return markup.gauge("elbow_flex", value, -100.0, 100.0, warns=warns)


def test_a_bar_stands_where_its_value_is_and_is_red_near_its_limits_only():
    for value, share in ((0.0, 50.0), (-100.0, 0.0), (250.0, 100.0)):
        assert f"left:{share}%" in gauge(value)
    assert ["near" in gauge(value) for value in (80.0, 97.0, -99.0)] == [False, True, True]
    assert "near" not in gauge(-99.0, warns=False)
    silent = markup.gauge("elbow_flex", -99.0, -100.0, 100.0, is_old=True)
    assert 'so101-gauge old"' in silent
    assert ">0.0 °<" in gauge(-0.0123)
    assert ">12.3 °<" in gauge(12.3456)


def test_every_mode_has_words():
    assert set(texts._MODES) == set(Mode)


@pytest.mark.parametrize(
    ("mode", "moves", "says"),
    [
        (Mode.HOLDING, False, "gripper has let go"),
        (Mode.MOVING, True, "Moving"),
        (Mode.STOPPING, True, "Stopping"),
    ],
)
def test_an_arm_that_moves_though_its_gripper_has_let_go_is_moving(mode, moves, says):
    reading = replace(STILL.reading, let_go=frozenset({"gripper"}))
    assert texts.mode(replace(STILL, reading=reading, mode=mode, arm_moving=moves)) == says


def test_a_bad_value_stands_out_and_no_other_whatever_it_begins_with():
    shown = markup.facts([("Note", "-21 mm"), ("Clearance", "-21 mm, jaw")], bad=("Clearance",))
    assert shown.count("so101-bad") == 1
    assert ">-21 mm<" in shown


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (Interrupted("stop"), "Stopped. The arm holds where it is. Press Plan to go on."),
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


def test_a_fault_is_said_first_what_only_warns_last_and_all_until_its_source_takes_it_back():
    bar = Bar()

    def alerts():
        return [each["text"] for each in json.loads(bar.text())["alerts"]]

    bar.alert("alarms", [Sentence("Late.", Tone.WARM), Sentence("Hot.", Tone.BAD)])
    bar.alert("connection", [Sentence("Fault.", Tone.BAD)])
    assert alerts() == ["Fault.", "Hot.", "Late."]
    bar.alert("alarms")
    assert json.loads(bar.text())["alerts"] == [{"tone": "bad", "text": "Fault."}]
