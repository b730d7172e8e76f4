from __future__ import annotations

from typing import Any

import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.drivers.port.port_list import FoundPort
from so101_motion.setup.checkup import Findings
from so101_motion.setup.connect import ConnectOperation
from so101_motion.setup.discovery import PortReport
from so101_motion.setup.port_selection import Candidate, PortsSeen


def candidate(name: str, **seen: Any) -> Candidate:
    port = FoundPort(name=name, device=name, key=name[-4:], is_servo_adapter=True)
    return Candidate(
        report=PortReport(port=port, sentence="an arm"), findings=Findings(port=name, **seen)
    )


FIRST, SECOND = candidate("/dev/ttyACM0"), candidate("/dev/ttyACM1")
BUSY = candidate("/dev/ttyACM2", port_trouble="in use by python3; end that first")


def connection(*candidates: Candidate, picked: str | None = None) -> ConnectOperation:
    model = ConnectOperation(PortsSeen)
    model.seen, model.picked = PortsSeen(candidates=candidates), picked
    return model


def test_before_the_first_look_nothing_is_chosen_and_that_is_said() -> None:
    model = ConnectOperation(PortsSeen)
    assert model.chosen is None
    assert "looking" in model.check.sentence


def test_the_only_port_is_taken_even_if_it_cannot_be_used_so_that_its_trouble_is_reported() -> None:
    assert connection(FIRST).chosen is FIRST
    assert connection(BUSY).chosen is BUSY
    assert "in use" in connection(BUSY).check.sentence


def test_a_port_that_can_be_used_goes_before_one_that_cannot() -> None:
    assert connection(BUSY, FIRST).chosen is FIRST


def test_among_several_a_person_chooses() -> None:
    model = connection(FIRST, SECOND)
    assert model.chosen is None
    assert "2 ports" in model.check.sentence
    model.picked = SECOND.name
    assert model.chosen is SECOND
    assert model.check.verdict != "fail"


def test_a_port_that_was_picked_and_unplugged_is_not_replaced_silently_by_several() -> None:
    assert connection(FIRST, SECOND, picked="/dev/ttyACM7").chosen is None


def test_without_a_port_nothing_is_chosen() -> None:
    model = connection()
    assert model.chosen is None
    assert model.check.verdict == "fail"


def test_it_looks_again_every_second_and_shows_what_is_wrong_with_each_port() -> None:
    now = [100.0]
    there = [PortsSeen(nothing=Findings(port_trouble="no servo adapter is plugged in"))]
    model = ConnectOperation(lambda: there[0], lambda: now[0])
    assert (model.view.offers[-1].due_in, model.view.doing) == (0.0, "looking at the ports")
    model.ask("look")
    assert model.view.trouble == "no servo adapter is plugged in"
    assert model.view.offers[-1].due_in == pytest.approx(1.0)
    there[0] = PortsSeen(candidates=(FIRST, SECOND))
    model.ask("look")
    view = model.view
    assert [row.mark for row in view.rows] == ["○", "○"]
    assert view.rows[1].text == "an arm. /dev/ttyACM1"
    assert [offer.title for offer in view.offers[:2]] == [
        f"Use {SECOND.name}",
        f"Use {FIRST.name}",
    ][::-1]
    model.ask("use", port=SECOND.name)
    assert [row.mark for row in model.view.rows[:2]] == ["○", "●"]
    with pytest.raises(ConfigError):
        model.ask("use", port="/dev/ttyACM9")
