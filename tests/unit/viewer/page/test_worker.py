import time

from so101_viewer.page.operation_panel import Worker

from so101_motion.common.errors import MotorSetupError


def silent():
    raise MotorSetupError("gripper", "no servo", "no servo answers", "plug it in")


def is_wrong_after(worker, look=None):
    """Whether anything is wrong once a look, or else what ``worker`` does, is over."""
    if look is not None:
        worker.watch(look)
    ends = time.monotonic() + 10.0
    while worker.is_looking or worker.doing:
        worker.collect()
        assert time.monotonic() < ends
    return worker.trouble is not None


def test_what_a_command_missed_is_said_until_a_look_that_missed_it_too_finds_it_again():
    worker = Worker()
    try:
        assert not is_wrong_after(worker, silent)
        assert not is_wrong_after(worker, lambda: None)
        worker.do("writing", silent)
        assert is_wrong_after(worker)
        assert is_wrong_after(worker, lambda: None)  # which proves nothing
        assert is_wrong_after(worker, silent)
        assert not is_wrong_after(worker, lambda: None)
    finally:
        worker.end()
