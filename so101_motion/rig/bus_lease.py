"""Lend the bus to a calibration or a motor setup, while nothing else may move the servos.

``BusLease`` fits ``calib.access.BusAccess``. ``HardwareRig.lend_bus`` makes it; a port has one at a
time. Meanwhile motions, torque and questions about servos are refused with a message that names the
purpose. A stop does no harm, and positions are still reported, as far as servos answer. The
borrower's jobs run on the port's I/O thread like everything else there.

Giving the bus back sets the servos up again, so a new calibration is in force from that moment.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from so101_motion.common.clock import Clock
from so101_motion.common.errors import Interrupted, MotionError, PortUnavailable, So101Error
from so101_motion.control.executor import Executor
from so101_motion.control.joint_controller import JointController
from so101_motion.drivers.bus.bus import Bus
from so101_motion.rig.servo_driver import ServoDriver

T = TypeVar("T")

_log = logging.getLogger(__name__)


class BusLease:
    """A loan of a port's bus until ``give_back``. Any thread but the port's may use it.

    Use it in a ``with`` block or call ``give_back``. ``purpose`` is as errors name it:
    ``"calibration"``. ``returned`` is called on the port's thread when the servos have been set up
    again. Raises ``MotionError`` if something moves, or the bus is lent already.
    """

    def __init__(
        self,
        executor: Executor,
        servos: ServoDriver,
        clock: Clock,
        *,
        purpose: str,
        returned: Callable[[], None],
    ) -> None:
        self.clock, self.purpose = clock, purpose
        self._executor, self._servos, self._returned = executor, servos, returned
        self._is_over = False
        self._trouble: Exception | None = None  # of the watching job, for the next call
        executor.ask(lambda control: control.lend(purpose, lambda _: servos.lend())).result()

    @property
    def port(self) -> str:
        return self._servos.settings.port

    def call(self, job: Callable[[Bus], T]) -> T:
        """Run ``job`` with the bus on the port's thread; waits for it.

        Raises what ``job`` raised, or the watching job before it; ``MotionError`` if the bus has
        been given back, or the port was closed.
        """

        def run() -> T:
            self._refuse_over()
            trouble, self._trouble = self._trouble, None
            if trouble is not None:
                raise trouble
            with self._servos.lent.bus() as bus:
                return job(bus)

        done: Future[T] = self._executor.requests.ask(run)
        return self._result(done)

    def watch(self, job: Callable[[Bus], None] | None) -> None:
        """Run ``job`` on the port's thread at every tick, 100 times a second; None ends it.

        A job that raises is not called again; the next ``call`` raises what it raised. While there
        is no port (``PortUnavailable``) it waits, and goes on when the port is back.
        """

        def begin(control: JointController) -> None:
            self._refuse_over()
            self._trouble = None
            control.watch(None if job is None else lambda: self._look(control, job))

        self._result(self._executor.ask(begin))

    def at_baud(self, baud: int) -> None:
        """Let the port talk at another rate from now on; the joints are not read meanwhile."""

        def change() -> None:
            self._refuse_over()
            self._servos.lent.at_baud(baud)

        self._result(self._executor.requests.ask(change))

    def give_back(self, *, hold: bool | None = False) -> None:
        """End the loan; set the servos up with the present calibration. May be called twice.

        All joints are limp afterwards, or with ``hold`` held where they are; None to hold them if a
        servo holds. The loan is over even if the servos cannot be set up or held now
        (``BusError``); the arm is in a fault until they can.
        """
        self._end(hold)

    def abandon(self) -> None:
        """End the loan after a borrower's failure; joints that are held stay held."""
        try:
            self._end(None)
        except So101Error as error:
            _log.warning("%s ended, but: %s", self.purpose, error)

    def __enter__(self) -> BusLease:
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if error is None:
            self.give_back()
        else:
            self.abandon()

    # How

    def _end(self, hold: bool | None) -> None:
        def end(control: JointController) -> None:
            if not self._is_over:
                self._is_over = True
                control.take_back(lambda _: self._take_back(hold))

        try:
            self._executor.ask(end).result()
        except Interrupted:  # the port was closed before
            self._is_over = True

    def _take_back(self, hold: bool | None) -> bool | None:
        self._servos.take_back(hold=bool(hold))
        self._returned()
        return hold if hold is not None or not self._servos.is_ours else self._servos.is_driving

    def _look(self, control: JointController, job: Callable[[Bus], None]) -> None:
        try:
            with self._servos.lent.bus() as bus:
                job(bus)
        except PortUnavailable:
            pass  # the port is opened again when it is back
        except Exception as error:  # the borrower's own; its next call raises it
            self._trouble = error
            control.watch(None)

    def _result(self, done: Future[T]) -> T:
        try:
            return done.result()
        except Interrupted as error:
            raise MotionError(
                f"{self.port} was closed while it was in use for {self.purpose}; open it again"
            ) from error

    def _refuse_over(self) -> None:
        if self._is_over:
            raise MotionError(f"the servos are no longer in use for {self.purpose}; start it again")
