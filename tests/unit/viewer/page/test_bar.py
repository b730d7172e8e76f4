import json
from types import SimpleNamespace

from so101_viewer.page.bar import Bar, BarButton
from so101_viewer.page.screen_state import Sentence, Tone


def widget(uuid):
    return SimpleNamespace(_impl=SimpleNamespace(uuid=uuid))


def test_the_bar_names_its_buttons_by_their_widgets():
    bar = Bar()
    bar.state, bar.title, bar.stop = "Idle, holding", "Arm on X", widget("s")
    why = "The joints are held already."
    bar.buttons = (BarButton(label="Hold", button=widget("h"), why_not=why),)
    told = json.loads(bar.text())
    assert told["so101"] == "bar"
    assert (told["state"], told["title"], told["stop"], told["plan"]) == (
        "Idle, holding", "Arm on X", "s", None,
    )  # fmt: skip
    assert told["buttons"] == [{"label": "Hold", "press": "h", "why_not": why, "asks": None}]


def test_a_fault_is_said_first_what_only_warns_last_and_all_until_its_source_takes_it_back():
    bar = Bar()

    def alerts():
        return [each["text"] for each in json.loads(bar.text())["alerts"]]

    bar.alert("alarms", [Sentence("Late.", Tone.WARM), Sentence("Hot.", Tone.BAD)])
    bar.alert("connection", [Sentence("Fault.", Tone.BAD)])
    assert alerts() == ["Fault.", "Hot.", "Late."]
    bar.alert("alarms")
    assert json.loads(bar.text())["alerts"] == [{"tone": "bad", "text": "Fault."}]
