from types import SimpleNamespace
from typing import cast

from so101_viewer.setup.setup_target import SetupTarget
from so101_viewer.setup.torque import SETTLED, TorqueWatch, torque


def bench(*, connected=True, holds=False):
    situation = SimpleNamespace(is_connected=connected, holds=holds)
    return cast(SetupTarget, SimpleNamespace(situation=situation, rig=None))


def test_limp_held_and_unknown_are_three_different_sentences():
    told = [
        torque(None),
        torque(bench(connected=False)),
        torque(bench(holds=None)),
        torque(bench(holds=True)),
        torque(bench(holds=False)),
    ]
    assert len({each.text for each in told}) == len(told)
    assert [each.is_on for each in told] == [None, None, None, True, False]


def test_a_look_at_the_motors_does_not_make_the_torque_flicker():
    now = [0.0]
    watch = TorqueWatch(lambda: now[0])
    limp, lost = bench(), bench(connected=False)
    assert watch.look(limp, is_blind=False)
    assert not watch.look(lost, is_blind=True)
    assert not watch.look(lost, is_blind=False)
    now[0] += 0.9 * SETTLED
    assert not watch.look(lost, is_blind=False)
    assert not watch.look(limp, is_blind=False)
    now[0] += 0.9 * SETTLED
    assert not watch.look(lost, is_blind=False)
    assert watch.shown == torque(limp)
    now[0] += SETTLED
    assert watch.look(lost, is_blind=False)
    assert watch.shown == torque(lost)


def test_a_new_bench_is_shown_at_once_even_while_its_motors_are_looked_for():
    watch = TorqueWatch(lambda: 0.0)
    assert watch.look(bench(holds=None), is_blind=True)
    assert watch.shown == torque(bench(holds=None))


def test_a_removed_bench_is_shown_at_once():
    watch = TorqueWatch(lambda: 0.0)
    watch.look(bench(), is_blind=False)
    assert watch.look(None, is_blind=False)
    assert watch.shown == torque(None)


def test_motors_that_answer_are_shown_although_answers_are_lost_again_and_again():
    now = [0.0]
    watch = TorqueWatch(lambda: now[0])
    silent, held, limp = bench(holds=None), bench(holds=True), bench(holds=False)
    assert watch.look(silent, is_blind=False)
    assert watch.look(held, is_blind=True)
    assert watch.shown == torque(held)
    told = set()
    for k in range(40):  # the joints are let go of, and every other answer is lost
        now[0] += 0.3 * SETTLED
        watch.look(silent if k % 2 else limp, is_blind=False)
        told.add(watch.shown.text)
    assert watch.shown == torque(limp)
    assert torque(silent).text not in told
