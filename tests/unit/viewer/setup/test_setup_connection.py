from __future__ import annotations

import threading
from typing import Any

from so101_viewer.setup.connection import PortChoice, PortWatch

from so101_motion.drivers.port.port_list import FoundPort
from so101_motion.setup.findings import Findings
from so101_motion.setup.port_report import PortReport
from so101_motion.setup.port_selection import Candidate, PortsSeen


def candidate(name: str, **seen: Any) -> Candidate:
    port = FoundPort(name=name, device=name, key=name[-4:], is_servo_adapter=True)
    return Candidate(
        report=PortReport(port=port, sentence="an arm"), findings=Findings(port=name, **seen)
    )


FIRST, SECOND = candidate("/dev/ttyACM0"), candidate("/dev/ttyACM1")
BUSY = candidate("/dev/ttyACM2", port_trouble="in use by python3; end that first")


def connection(*candidates: Candidate, picked: str | None = None) -> PortChoice:
    model = PortChoice()
    model.seen, model.picked = PortsSeen(candidates=candidates), picked
    return model


def test_before_the_first_look_nothing_is_chosen_and_that_is_said() -> None:
    model = PortChoice()
    assert model.chosen is None
    assert model.check is not None
    assert "looking" in model.check.sentence


def test_the_only_port_is_taken_even_if_it_cannot_be_used_so_that_its_trouble_is_reported() -> None:
    assert connection(FIRST).chosen is FIRST
    assert connection(BUSY).chosen is BUSY
    assert connection(BUSY).check is None


def test_a_port_that_can_be_used_goes_before_one_that_cannot() -> None:
    assert connection(BUSY, FIRST).chosen is FIRST


def test_among_several_a_person_chooses() -> None:
    model = connection(FIRST, SECOND)
    assert model.chosen is None
    assert model.check is not None
    assert "2 ports" in model.check.sentence
    model.picked = SECOND.name
    assert model.chosen is SECOND
    assert model.check is None


def test_a_port_that_was_picked_and_unplugged_is_not_replaced_silently_by_several() -> None:
    assert connection(FIRST, SECOND, picked="/dev/ttyACM7").chosen is None


def test_without_a_port_nothing_is_chosen() -> None:
    model = connection()
    assert model.chosen is None
    assert model.check is None  # the workflow's own check says what is the matter


def test_the_lookout_looks_until_it_is_told_to_end_and_can_begin_again() -> None:
    looked = threading.Semaphore(0)

    def look() -> PortsSeen:
        looked.release()
        return PortsSeen(candidates=(FIRST,))

    lookout = PortWatch(look)
    lookout.end()
    for _ in range(2):
        lookout.begin()
        lookout.begin()
        assert looked.acquire(timeout=60.0)
        lookout.end()
    assert lookout.seen is not None
    assert lookout.seen.candidates == (FIRST,)
