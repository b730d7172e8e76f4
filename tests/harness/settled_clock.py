"""A pretended clock that waits for emulated servos to hear what was sent to them."""

from referee import all_is_heard

from so101_motion.common.clock import ManualClock


class SettledClock(ManualClock):
    """Time passes only when the servos have heard every goal.

    Nobody answers a goal. Without this a servo would obey one that is sent last in a cycle in that
    very cycle or in the next, as the threads happen to run, and friction makes much of that.
    """

    def wait(self, until, wake):
        all_is_heard()
        super().wait(until, wake)
