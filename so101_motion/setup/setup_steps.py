"""The steps from a box of parts to a moving arm, and whether each is done in a ``SetupState``.

A failed check means that the user cannot go on yet: its sentence says what is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from so101_motion.calib.motors.setup_view import SetupView
from so101_motion.calib.procedure import view as calibration_view
from so101_motion.calib.procedure.steps import State
from so101_motion.calib.procedure.view import CalibrationProgress, CalibrationView
from so101_motion.common.attributes import suggest
from so101_motion.common.errors import ConfigError
from so101_motion.common.state import GRIPPER_JOINT
from so101_motion.setup.calibrator import Calibrator
from so101_motion.setup.checkup import Check, Findings, check_port, check_servos, fail, ok, warn
from so101_motion.setup.motor_operation import PUT_TOGETHER


@dataclass(frozen=True, slots=True, kw_only=True)
class SetupState:
    """The state of a setup, which the steps judge."""

    # the findings about the port and the servos of the finished chain
    seen: Findings = field(default_factory=Findings)
    setup: SetupView = field(default_factory=SetupView)  # the state of the motor setup
    view: CalibrationView = field(  # the state of the calibration
        default_factory=lambda: calibration_view.show(CalibrationProgress(), None, 0.0)
    )
    is_assembled: bool = False  # whether a person has checked every joint of the assembled arm
    saved: Path | str | None = None  # the file of the calibration in force; None before it is saved
    tested: Check | None = None  # the result of the final test; None before it

    @classmethod
    def found(cls, seen: Findings) -> SetupState:
        is_saved = seen.stored is not None and not seen.file_trouble and not seen.is_unfinished
        return cls(seen=seen, saved=seen.file if is_saved else None)

    @classmethod
    def of(cls, calibrator: Calibrator) -> SetupState:
        now = calibrator.situation
        return cls(
            seen=Findings(
                port=calibrator.port,
                adapter="in use",
                port_trouble="" if now.is_connected else "there is no connection at present",
                servos=calibrator.motors.checked,
            ),
            setup=now.setup,
            view=now.view,
            saved=now.saved,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SetupStep:
    """One step of a setup."""

    name: str
    title: str
    instruction: str
    minutes: int  # how long it takes a beginner. Chosen
    check: Callable[[SetupState], Check]


@dataclass(frozen=True, slots=True, kw_only=True)
class Workflow:
    """A list of steps for one purpose."""

    name: str
    title: str
    purpose: str
    steps: tuple[SetupStep, ...]

    @property
    def minutes(self) -> int:
        """How long it takes, without the time to assemble the arm."""
        return sum(step.minutes for step in self.steps)

    @property
    def extent(self) -> str:
        return f"{len(self.steps)} steps, about {self.minutes} minutes"

    def place(self, name: str) -> int | None:
        return next((k for k, step in enumerate(self.steps) if step.name == name), None)

    def next_open(self, known: SetupState) -> SetupStep | None:
        return next((step for step in self.steps if step.check(known).verdict == "fail"), None)


def listed(workflow: str, known: SetupState) -> dict[str, Any]:
    wanted = next((each for each in WORKFLOWS if each.name == workflow), None)
    if wanted is None:
        raise ConfigError("workflow", workflow, suggest(workflow, [w.name for w in WORKFLOWS]))
    left = wanted.next_open(known)
    return {
        "workflow": wanted.name,
        "title": wanted.title,
        "minutes": wanted.minutes,
        "steps": [
            {
                "name": step.name,
                "title": step.title,
                "instruction": step.instruction,
                "minutes": step.minutes,
                "verdict": (check := step.check(known)).verdict,
                "message": check.sentence,
                "fix": check.fix or None,
            }
            for step in wanted.steps
        ],
        "next_step": None if left is None else left.name,
    }


# Whether a step is done


def worst(name: str, checks: Iterable[Check]) -> Check | None:
    """The worst of ``checks``, the first one of equals, under another name; None without checks."""
    ranked = sorted(checks, key=lambda check: ("fail", "warn", "ok").index(check.verdict))
    if not ranked:
        return None
    first = ranked[0]
    return Check(name=name, verdict=first.verdict, sentence=first.sentence, fix=first.fix)


def _connected(known: SetupState) -> Check:
    seen = known.seen
    if seen.port is not None:
        seen = replace(seen, lost_adapters=())
    return worst("connect", check_port(seen)) or fail(
        "connect", "no port is chosen yet", "plug the adapter in with a USB cable"
    )


def _numbered(known: SetupState) -> Check:
    setup = known.setup
    joint = setup.next_joint
    if joint is None:
        left_out = [motor.joint for motor in setup.motors.values() if motor.state == "skipped"]
        if left_out:
            text = f"left as they are: {', '.join(left_out)}"
            return warn("motors", text, "set them up later")
        return ok("motors", "all six motors have their ids")
    servos = known.seen.servos
    if not setup.in_progress and servos is not None:
        states = {check.status for check in servos.motors.values()}
        # a silent one may have a loose cable
        has_stranger = servos.unexpected_ids and "not_responding" in states
        if "duplicate" not in states and not has_stranger:
            return ok("motors", "the motors have their ids already")
    motor = setup.motors[joint]
    text = f"{6 - setup.step} of 6 motors have not got their ids yet; next is {joint}"
    if motor.state == "failed":
        text = f"{joint}: {motor.sentence}"
    return fail("motors", text, setup.next_step)


def _complete(known: SetupState) -> Check:
    servos = known.seen.servos
    if known.view.state is not State.IDLE:
        return ok("chain", "the arm is being calibrated")
    if servos is None:
        return fail(
            "chain",
            "the finished chain has not been verified yet",
            "connect all six servos in a chain, shoulder_pan at the adapter, then verify",
        )
    found = worst("chain", check_servos(servos))
    assert found is not None  # servos that were examined always give a check
    jaw = servos.motors[GRIPPER_JOINT]
    if found.verdict != "fail" and jaw.status == "not_responding":  # no more than a warning there
        return fail("chain", jaw.error, jaw.fix)
    return found


def _assembled(known: SetupState) -> Check:
    if known.saved is not None:
        return ok("assembly", "the arm is calibrated, so it is assembled")
    if known.is_assembled:
        return ok("assembly", "every joint was checked")
    text = "this program cannot see whether the arm is assembled"
    return warn("assembly", text, "screw it together, then check joint by joint")


def _reached(known: SetupState, *, name: str, states: Collection[State] = (), left: str) -> Check:
    view = known.view
    if known.saved is not None:
        return ok(name, f"calibrated: {known.saved}")
    if view.state in states and view.error is None:
        return ok(name, f"done: {view.state.value}")
    return fail(name, view.error or left, view.instruction)


def _recorded(known: SetupState) -> Check:
    left = "the travel of the joints is not recorded yet"
    if known.view.state is State.RECORDING:
        joints = [joint for joint, view in known.view.joints.items() if not view.is_done]
        left = f"still to do: {', '.join(joints)}" if joints else "the recording goes on"
    return _reached(known, name="record", states=(State.COMPLETED,), left=left)


_UNTESTED = warn(
    "test", "the arm has not been tested yet", "let it make small slow motions and check them"
)


def _usable(known: SetupState) -> Check:
    if known.saved is None:
        return fail(
            "configure", "there is no calibration to configure yet", "calibrate the arm first"
        )
    return ok("configure", "ready to be used")


# The steps

CONNECT = SetupStep(
    name="connect",
    title="Connection",
    instruction="Plug the adapter board into this computer with a USB cable, and switch the arm's"
    " own power supply on: USB does not feed the motors.",
    minutes=1,
    check=_connected,
)

MOTORS = SetupStep(
    name="motors",
    title="Motor ids",
    instruction="Each motor needs its own id. New motors all have id 1, so connect and set them one"
    " at a time, from the gripper to the shoulder.",
    minutes=6,
    check=_numbered,
)

CHAIN = SetupStep(
    name="chain",
    title="All six together",
    instruction=f"{PUT_TOGETHER} Then verify them.",
    minutes=2,
    check=_complete,
)

ASSEMBLY = SetupStep(
    name="assembly",
    title="Assembly",
    instruction="Switch the power off and screw the arm together, each motor in its own joint; that"
    " takes an hour or two, and this page waits. Then check joint by joint.",
    minutes=0,
    check=_assembled,
)

POSE = SetupStep(
    name="pose",
    title="Homing pose",
    instruction="Once the arm is screwed together: hold it, let its joints go limp, and bring each"
    " about into the middle of its travel.",
    minutes=2,
    check=partial(
        _reached,
        name="pose",
        states=(State.HOMED, State.RECORDING, State.COMPLETED),
        left="the homing pose is not taken yet",
    ),
)

RECORD = SetupStep(
    name="record",
    title="Travel",
    instruction="Move every joint slowly through its whole travel, to both stops.",
    minutes=2,
    check=_recorded,
)

SAVE = SetupStep(
    name="save",
    title="Save",
    instruction="Look at what was recorded, then store it in the motors and in a file.",
    minutes=1,
    check=partial(_reached, name="save", left="the calibration is not saved yet"),
)

TEST = SetupStep(
    name="test",
    title="Final test",
    instruction="Let the arm make small slow motions, joint by joint, and check that it follows"
    " commands.",
    minutes=2,
    check=lambda known: known.tested or _UNTESTED,
)

CONFIGURE = SetupStep(
    name="configure",
    title="Use it",
    instruction="Copy the configuration, or move the arm on its page.",
    minutes=1,
    check=_usable,
)

_CALIBRATION = (POSE, RECORD, SAVE, TEST, CONFIGURE)

FULL = Workflow(
    name="full",
    title="Full Setup",
    purpose="A new kit: each motor gets its number, the id. You screw the arm together, which takes"
    " an hour or two more. Then it is calibrated and tested.",
    steps=(CONNECT, MOTORS, CHAIN, ASSEMBLY, *_CALIBRATION),
)

MOTORS_ONLY = Workflow(
    name="motors",
    title="Motor Setup Only",
    purpose="Before the arm is screwed together, or after a motor was replaced.",
    steps=(CONNECT, MOTORS, CHAIN),
)

CALIBRATION_ONLY = Workflow(
    name="calibration",
    title="Calibration Only",
    purpose="The motors have their ids, and the arm is together.",
    steps=(CONNECT, CHAIN, *_CALIBRATION),
)

WORKFLOWS = (FULL, MOTORS_ONLY, CALIBRATION_ONLY)
"""All workflows, in the order in which they are offered."""
