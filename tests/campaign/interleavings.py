"""Requests to an arm in random order, with faults on its bus among them, on simulated time.

An interleaving is some requests with pauses between them, and a Stop at the end. Laws: every
request ends, with success or with an error of ours; after the Stop nothing moves; the referee
finds nothing.
"""

from harness.clocks import TurnClock

from campaign.campaign_arm import Arm
from so101_motion.common.errors import So101Error

LONGEST = 20.0  # [s] of simulated time that a request may take after the Stop
PAUSES = (0.0, 0.0, 0.01, 0.03, 0.1, 0.3)
LONG_PAUSES = (*PAUSES[1:], 1.0, 2.0)
"""Among faults, which act on an arm at rest, too."""


class Interleaver:
    """Asks one arm for this and that.

    Attributes:
        broken: Laws that were broken.
    """

    def __init__(self, seed, clock, *, faulty):
        self.arm, self.faulty, self.broken = Arm(seed, clock), faulty, []
        arm = self.arm
        self._asks = [
            arm.move, arm.move, arm.retarget, arm.retarget, arm.jaw, arm.stop, arm.stream,
            arm.jog, arm.follow, arm.manual, arm.hold, arm.limp, arm.torque_limit,
            arm.reconfigure, arm.close,
        ]  # fmt: skip
        self._asks += [arm.disturb] * 4 if faulty else []

    def interleave(self):
        """One of them; what it breaks goes to ``broken``."""
        arm, futures = self.arm, []
        arm.said.clear()
        for _ in range(arm.rng.randint(2, 7)):
            ask = arm.rng.choice(self._asks)
            if ask != arm.disturb:
                arm.note(ask.__name__)
            try:
                futures.append(ask())
            except So101Error:
                pass
            except Exception as error:
                self._object(f"{type(error).__name__} when asked: {error}")
            arm.clock.advance(arm.rng.choice(LONG_PAUSES if self.faulty else PAUSES))
        if self.faulty and arm.rng.random() < 0.5:
            arm.heal()
        self._end([future for future in futures if future is not None])

    def _end(self, futures):
        arm = self.arm
        futures.append(arm.executor.stop())
        waited = 0.0
        while not all(future.done() for future in futures) and waited < LONGEST:
            arm.clock.advance(0.05)
            waited += 0.05
        for future in futures:
            if not future.done():
                self._object(f"a request did not end within {LONGEST} s")
                continue
            error = future.exception(timeout=0)
            if error is not None and not isinstance(error, So101Error):
                self._object(f"{type(error).__name__}: {error}")
        arm.clock.advance(0.1)
        for finding in arm.referee.findings:
            self._object(str(finding))
        arm.referee.findings.clear()

    def _object(self, what):
        self.broken.append(f"after {' '.join(self.arm.said)}: {what}")


def run(seed, *, count, faulty=False):
    """``count`` interleavings on one arm: what was done, and the laws that were broken."""
    clock = TurnClock()
    with clock.everywhere():
        one = Interleaver(seed, clock, faulty=faulty)
        arm = one.arm
        for _ in range(count):
            one.interleave()
            is_held = arm.executor.state.mode.value in ("holding", "moving", "stopping")
            if not is_held and arm.rng.random() < 0.7:
                arm.recover()
        arm.end()
    return arm.done, one.broken
