from __future__ import annotations

from typing import Any

import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.drivers.port.port_list import FoundPort
from so101_motion.setup.checkup import Findings
from so101_motion.setup.connect import Candidate, ConnectOperation, PortsSeen
from so101_motion.setup.discovery import PortReport


def candidate(name: str, **seen: Any) -> Candidate:
    port = FoundPort(name=name, device=name, key=name[-4:], is_servo_adapter=True)
    return Candidate(
        report=PortReport(port=port, sentence="an arm"), findings=Findings(port=name, **seen)
    )


FIRST, SECOND = candidate("/dev/ttyACM0"), candidate("/dev/ttyACM1")
BUSY = candidate("/dev/ttyACM2", port_trouble="in use by python3; end that program first")


@pytest.mark.parametrize(
    ("candidates", "picked", "chosen", "words"),
    [
        ((), None, None, ""),
        ((FIRST,), None, FIRST, ""),
        ((BUSY,), None, BUSY, "in use"),  # so that its trouble is reported
        ((BUSY, FIRST), None, FIRST, ""),
        ((FIRST, SECOND), None, None, "2 ports"),  # a person chooses
        ((FIRST, SECOND), SECOND.name, SECOND, ""),
        ((FIRST, SECOND), "/dev/ttyACM7", None, ""),  # unplugged: not replaced silently
    ],
)
def test_a_port_is_chosen_if_it_is_the_only_usable_one_or_picked(
    candidates: tuple[Candidate, ...], picked: str | None, chosen: Candidate | None, words: str
) -> None:
    model = ConnectOperation(PortsSeen)
    assert model.chosen is None
    assert "looking" in model.check.sentence
    model.seen, model.picked = PortsSeen(candidates=candidates), picked
    assert model.chosen is chosen
    assert words in model.check.sentence
    assert (model.check.verdict == "fail") is (chosen in (None, BUSY))


def test_it_looks_again_every_second_and_shows_what_is_wrong_with_each_port() -> None:
    now = [100.0]
    there = [PortsSeen(nothing=Findings(port_trouble="no servo adapter is plugged in"))]
    model = ConnectOperation(lambda: there[0], now=lambda: now[0])
    assert (model.view.offers[-1].due_in, model.view.doing) == (0.0, "looking at the ports")
    model.ask("look")
    assert model.view.trouble == "no servo adapter is plugged in"
    assert model.view.offers[-1].due_in == pytest.approx(1.0)
    there[0] = PortsSeen(candidates=(FIRST, SECOND))
    model.ask("look")
    view = model.view
    assert [row.mark for row in view.rows] == ["○", "○"]
    assert view.rows[1].text == "an arm"
    assert [offer.title for offer in view.offers[:2]] == [f"Use {p.name}" for p in (FIRST, SECOND)]
    model.ask("use", port=SECOND.name)
    assert [row.mark for row in model.view.rows[:2]] == ["○", "●"]
    with pytest.raises(ConfigError):
        model.ask("use", port="/dev/ttyACM9")
