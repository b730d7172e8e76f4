"""Start and stop following a leader arm, without viser.

The leader is an arm on another port of this computer, or that of a machine's teleoperation service.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import partial
from typing import Any, Protocol

from so101_motion.common.errors import Interrupted, So101Error
from so101_motion.common.units import to_deg
from so101_motion.rig.protocols import RigLike
from so101_motion.rig.rig import Rig
from so101_motion.tasks.teleop import LocalFollower, LocalLeader, Status, Teleop
from so101_motion.tasks.teleop.local_arms import side_of
from so101_motion.viam.client import MachineRig

from ..page import texts
from ..page.screen_state import Sentence, Tone

OFF = Sentence(text="Keep a hand on the leader: it goes limp, and this arm moves to it slowly.")
STARTS = Sentence(text="Starting …", tone=Tone.WARM)

LOOK_EVERY = 1.0
"""How often a machine is asked how its arm follows [s]; chosen."""

OpenLeader = Callable[[], Rig]
"""Opens the leader arm; raises ``So101Error`` while it cannot be reached."""


class Session(Protocol):
    """A teleoperation that is started and stopped. All but ``words`` may take a while."""

    def start(self) -> None:
        """Let the leader go limp, and this arm come to it."""

    def stop(self) -> None:
        """Let both hold."""

    def look(self) -> None:
        """Read its state, for ``words``."""

    def close(self) -> None:
        """Stop, and close what was opened."""

    def words(self) -> Sentence | None:
        """What it does; None when it does not run."""


class LocalSession:
    """A leader on a port of this computer.

    Args:
        follower: The arm of the page.
        open_leader: Opens the leader, at the first start.
    """

    def __init__(self, follower: Rig, open_leader: OpenLeader) -> None:
        self._follower, self._open = follower, open_leader
        self._leader: Rig | None = None
        self._teleop: Teleop | None = None
        self._stops = 0

    def start(self) -> None:
        """See ``Session.start``."""
        stops = self._stops
        if self._leader is None:
            self._leader = self._open()
        if self._teleop is None:
            self._teleop = Teleop(
                LocalLeader(side_of(self._leader, self._leader)),
                LocalFollower(side_of(self._follower, self._follower)),
                self._follower.clock,
            )
        self._refuse_stopped(stops)
        self._teleop.start()
        self._refuse_stopped(stops)

    def stop(self) -> None:
        """See ``Session.stop``."""
        self._stops += 1
        if self._teleop is not None:
            self._teleop.stop()

    def look(self) -> None:
        """See ``Session.look``; nothing to read: the state is in this process."""

    def close(self) -> None:
        """See ``Session.close``."""
        if self._teleop is not None:
            self._teleop.close()
        if self._leader is not None:
            self._leader.close()

    def words(self) -> Sentence | None:
        """See ``Session.words``."""
        return None if self._teleop is None else status_words(self._teleop.status)

    def _refuse_stopped(self, stops: int) -> None:
        """End a start during which somebody stopped.

        Raises:
            Interrupted: Somebody did.
        """
        if self._stops != stops:
            if self._teleop is not None:
                self._teleop.stop()
            raise Interrupted("stop")


class MachineSession:
    """A machine's own teleoperation service.

    Args:
        rig: The machine.
        name: The service's name.
    """

    def __init__(self, rig: MachineRig, name: str) -> None:
        self._rig, self._name = rig, name
        self._status: Mapping[str, Any] = {}

    def start(self) -> None:
        """See ``Session.start``."""
        self._rig.do_command(self._name, {"command": "start"})
        self.look()

    def stop(self) -> None:
        """See ``Session.stop``."""
        self._rig.do_command(self._name, {"command": "stop"})
        self.look()

    def look(self) -> None:
        """See ``Session.look``."""
        self._status = self._rig.do_command(self._name, {"command": "status"})

    def close(self) -> None:
        """Leave it as it is: it is the machine's own."""

    def words(self) -> Sentence | None:
        """See ``Session.words``."""
        if not self._status.get("running"):
            return None
        phase = self._status.get("state")
        if phase == "mirroring":
            return Sentence(text="The machine's arm follows its leader.", tone=Tone.GOOD)
        if phase == "approaching":
            return Sentence(text="The machine's arm moves to its leader.", tone=Tone.WARM)
        why = self._status.get("reason") or "move the leader back to it"
        return Sentence(text=f"The machine's arm holds: {why}.", tone=Tone.WARM)


def session_for(rig: RigLike, open_leader: OpenLeader | None) -> Session | None:
    """The session that is possible with this arm; None if there is no leader."""
    if isinstance(rig, MachineRig):
        services = (each.name for each in rig.resources if each.api == "service:generic")
        name = next((name for name in services if _is_teleop(rig, name)), None)
        return None if name is None else MachineSession(rig, name)
    if isinstance(rig, Rig) and open_leader is not None:
        return LocalSession(rig, open_leader)
    return None


def _is_teleop(rig: MachineRig, name: str) -> bool:
    try:
        return "consecutive_errors" in rig.do_command(name, {"command": "status"})
    except So101Error:
        return False


class Leading:
    """A switch for a session. For the page's thread.

    Args:
        session: The session.
        submit: Runs a slow call on another thread.
        now: The time [s].
    """

    def __init__(
        self,
        session: Session,
        submit: Callable[[Callable[[], Any]], Future[Any]],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._session, self._submit, self._now = session, submit, now
        self._switching: Future[None] | None = None
        self._looking: Future[None] | None = None
        self._look_due = 0.0
        self._trouble: Sentence | None = None
        self._ends = 0

    @property
    def is_on(self) -> bool:
        """Whether this arm follows, as far as is known."""
        return self._session.words() is not None

    @property
    def can_switch(self) -> bool:
        """Whether the switch may be pressed."""
        return self._switching is None

    def toggle(self) -> None:
        """Follow the leader, or end that."""
        if self.can_switch:
            self._trouble = None
            start = partial(self._start, self._ends)
            self._switching = self._submit(self._session.stop if self.is_on else start)

    def refresh(self) -> None:
        """Take in whether it has started, and read its state now and then."""
        if self._switching is not None and self._switching.done():
            switching, self._switching = self._switching, None
            error = switching.exception()
            self._trouble = None if error is None else texts.ended(error)
        is_idle = self._looking is None or self._looking.done()
        if is_idle and self._now() >= self._look_due:
            self._look_due = self._now() + LOOK_EVERY
            self._looking = self._submit(self._session.look)

    def end(self) -> None:
        """End it, also while it starts or waits for the leader; any thread. May take a while."""
        self._ends += 1
        if self.is_on or not self.can_switch:
            with contextlib.suppress(So101Error):  # who cannot be reached does not follow
                self._session.stop()

    def _start(self, ends: int) -> None:
        if self._ends != ends:  # it was ended before a thread was free
            raise Interrupted("stop")
        self._session.start()

    @property
    def sentence(self) -> Sentence:
        """What it does, or why it does not."""
        if self._switching is not None:
            return STARTS
        return self._trouble or self._session.words() or OFF

    def close(self) -> None:
        """End it."""
        with contextlib.suppress(So101Error):  # an arm that cannot be reached does not follow
            self._session.close()


def status_words(status: Status) -> Sentence | None:
    """A teleoperation's state in a sentence; None when it does not run."""
    if not status.is_running:
        return None
    joint, gap = status.gap
    if status.phase.value == "approaching":
        text = f"Moving to the leader: {joint} is {to_deg(gap):.0f}° away."
        return Sentence(text=text, tone=Tone.WARM)
    if status.phase.value == "waiting":
        where = f" {joint} is {to_deg(gap):.0f}° from this arm's." if joint else ""
        text = f"Holding: {status.reason}.{where} Move the leader back to it."
        return Sentence(text=text, tone=Tone.WARM)
    if status.is_held:
        return Sentence(text="Following; something is in this arm's way.", tone=Tone.WARM)
    if status.beyond:
        text = f"Following; {', '.join(status.beyond)} beyond this arm's range."
        return Sentence(text=text, tone=Tone.WARM)
    return Sentence(text="Following the leader.", tone=Tone.GOOD)
