"""A running calibration as one immutable value, made of joints' progress and last positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from so101_motion.calib.procedure import travel
from so101_motion.calib.procedure.sampler import Positions
from so101_motion.calib.procedure.steps import INSTRUCTIONS, OFFERED, Command, State
from so101_motion.calib.procedure.travel import Assessment, Fit, TravelArc, Verdict
from so101_motion.calib.record import zero
from so101_motion.calib.record.record import SERVO_IDS, HeldCalibration
from so101_motion.drivers.bus.registers import TICKS_PER_TURN

TICKS_PER_DEG = TICKS_PER_TURN / 360.0
_STALE = 1.0  # [s], chosen: storing into the servos keeps the bus busy for up to a fifth of that


@dataclass(frozen=True, slots=True, kw_only=True)
class JointProgress:
    """The progress of one joint."""

    joint: str
    before: HeldCalibration  # what its servo held before, as it can be restored
    held: HeldCalibration  # what its servo holds now
    driven: bool = False  # whether its torque was on when the calibration began
    counts_down: bool = False  # whether its encoder is set up to count the wrong way round
    home: int | None = None  # what it reads in the homing pose [tick]; None before
    # offset and travel that are about to be saved; None before the recording has ended
    fit: Fit | None = None
    # the verdict on its travel; None before the recording has ended
    assessment: Assessment | None = None

    @property
    def expected(self) -> int:
        """Its travel from stop to stop [tick]."""
        return round(zero.expected_travel(self.joint))

    def assess(self, arc: TravelArc | None) -> Assessment:
        assert self.home is not None
        return travel.assess(
            self.joint, arc, expected=self.expected, home=self.home, counts_down=self.counts_down
        )

    def fitted(self, arc: TravelArc | None, assessment: Assessment) -> Fit:
        assert self.home is not None
        if arc is None or assessment.verdict is Verdict.FULL_TURN:
            return travel.full_turn(offset=self.held.homing_offset, home=self.home)
        return travel.fit(arc, offset=self.held.homing_offset, home=self.home)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationProgress:
    """The progress of a calibration."""

    state: State = State.IDLE
    joints: Mapping[str, JointProgress] = field(default_factory=dict)
    error: str | None = None  # why the last command failed; None if it succeeded
    note: str | None = None
    started_at: float = 0.0  # when the recording began [s]
    recorded_for: float | None = 0.0  # how long it took [s]; None while it runs


@dataclass(frozen=True, slots=True, kw_only=True)
class JointView:
    """The calibration of one joint at one instant."""

    joint: str
    servo_id: int
    # where it is [tick]; None if that is not known. While a travel that passes the seam is
    # recorded, readings go on below 0 or above 4095
    ticks: int | None = None
    homing_offset: int  # the servo's, in force or about to be saved [tick]
    range_min: int  # lower limit in force or about to be saved [tick]
    range_max: int  # upper limit
    # lower end of the recorded travel [tick]; None before there is one
    recorded_min: int | None = None
    recorded_max: int | None = None  # upper end
    expected_deg: float  # the travel from stop to stop [deg]
    verdict: Verdict | None = None  # the verdict on the travel; None before a recording
    sentence: str  # what that means and what to do; empty before a recording
    is_done: bool

    @property
    def travel(self) -> int:
        """How far it has moved while it was recorded [tick]."""
        if self.recorded_min is None or self.recorded_max is None:
            return 0
        return self.recorded_max - self.recorded_min

    @property
    def travel_deg(self) -> float:
        """How far it has moved while it was recorded [deg]."""
        return self.travel / TICKS_PER_DEG


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationView:
    """A calibration at one instant."""

    state: State
    instruction: str
    # the joints that are calibrated, by name, base to jaw; none before the start
    joints: Mapping[str, JointView]
    commands: tuple[Command, ...]
    error: str | None = None  # what is wrong at present and what to do about it; None if nothing is
    note: str | None = None  # another message for the user; None if there is none
    recording_time: float = 0.0  # how long the recording has taken so far [s]
    samples: int = 0
    held_for: float = 0.0  # how long the arm has been held still [s]
    grown_for: float = 0.0  # how long no travel has grown [s]
    t: float = 0.0  # the time of the clock by which all this was read [s]


def show(progress: CalibrationProgress, seen: Positions | None, now: float) -> CalibrationView:
    """Make the view of a calibration at ``now`` [s]; ``seen`` is None while nothing is read."""
    joints = {
        joint: _show_joint(
            known, seen or Positions(), is_recording=progress.state is State.RECORDING
        )
        for joint, known in progress.joints.items()
    }
    recorded_for = progress.recorded_for
    return CalibrationView(
        state=progress.state,
        instruction=_instruction(progress.state, joints),
        joints=joints,
        commands=OFFERED[progress.state],
        error=_error(progress, None if seen is None else _trouble(seen, now)),
        note=progress.note,
        recording_time=now - progress.started_at if recorded_for is None else recorded_for,
        samples=0 if seen is None else seen.samples,
        held_for=0.0 if seen is None else now - seen.held_since,
        grown_for=0.0 if seen is None else now - max(seen.grown_at, progress.started_at),
        t=now,
    )


def _error(progress: CalibrationProgress, trouble: str | None) -> str | None:
    """The error to show: while joints are recorded, a present problem before an old one."""
    if progress.state is State.RECORDING:
        return trouble or progress.error
    return progress.error or trouble


def _show_joint(known: JointProgress, seen: Positions, *, is_recording: bool) -> JointView:
    fit, arc, ticks = known.fit, seen.arcs.get(known.joint), seen.ticks.get(known.joint)
    ends: tuple[int | None, int | None] = (None, None)
    if fit is not None:
        ends, arc = (fit.lower, fit.upper), TravelArc(fit.lower, fit.upper - fit.lower)
        ticks = None if ticks is None else ticks + known.held.homing_offset - fit.homing_offset
    elif arc is not None:
        ends = (arc.lower, arc.upper)
    if arc is not None and ticks is not None:
        ticks = arc.unrolled(ticks)
    assessment = known.assess(arc) if is_recording else known.assessment
    sentence = "" if assessment is None else assessment.sentence
    return JointView(
        joint=known.joint,
        servo_id=SERVO_IDS[known.joint],
        ticks=ticks,
        homing_offset=known.held.homing_offset if fit is None else fit.homing_offset,
        range_min=known.held.range_min if fit is None else fit.lower,
        range_max=known.held.range_max if fit is None else fit.upper,
        recorded_min=ends[0],
        recorded_max=ends[1],
        expected_deg=known.expected / TICKS_PER_DEG,
        verdict=None if assessment is None else assessment.verdict,
        sentence="its servo does not answer" if known.joint in seen.silent else sentence,
        is_done=assessment is not None and assessment.is_usable,
    )


def _instruction(state: State, joints: Mapping[str, JointView]) -> str:
    if state is not State.RECORDING:
        return INSTRUCTIONS[state]
    left = [joint for joint, view in joints.items() if not view.is_done]
    if not left:
        return f"{INSTRUCTIONS[state]} All have moved far enough: stop the recording when done."
    return f"{INSTRUCTIONS[state]} Still to do: {', '.join(left)}."


def _trouble(seen: Positions, now: float) -> str | None:
    if now - seen.t > _STALE:
        return (
            f"nothing could be read for {now - seen.t:.0f} s; check that the USB cable is plugged"
            " in. What was recorded is kept"
        )
    if not seen.silent:
        return None
    return (
        f"no reply from {', '.join(seen.silent)}; check the power supply and the cables. The"
        " recording goes on when they answer again"
    )
