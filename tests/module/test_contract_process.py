"""A few promises of the contract of an arm, on one in a real module process, over TCP."""

from contextlib import closing
from functools import partial

import pytest
from contract import test_arm as arm
from contract import test_gripper as gripper
from harness.contract_benches import OnMachine

PROMISES = {
    "a move carries out its plan": (
        arm.test_a_move_carries_out_the_very_plan_it_was_given_and_ends_at_its_goal
    ),
    "waypoints are passed": arm.test_waypoints_are_passed_and_the_path_is_kept,
    "a newer move ends the older": arm.test_a_newer_move_ends_the_older_one_and_arrives,
    "a stop brings it to rest": partial(
        arm.test_a_stop_at_any_instant_brings_the_arm_to_rest_on_its_path,
        seconds=0.7, least=0.0, most=1.0,
    ),
    "a new target is turned to": arm.test_a_new_target_is_turned_to_without_a_stop,
    "the jaw opens and closes": (
        gripper.test_the_jaw_opens_as_far_as_it_is_told_and_closes
    ),
}  # fmt: skip


@pytest.mark.parametrize("promise", PROMISES.values(), ids=PROMISES)
def test_an_arm_in_a_module_process_keeps_the_contract(machine, promise):
    with closing(OnMachine(machine)) as bench:
        promise(bench, bench.rig)
