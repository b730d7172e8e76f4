"""The SO-101 arm as a robot of LeRobot: ``--robot.type=so101_motion``."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots import Robot
from lerobot.utils.constants import ROBOTS

from lerobot_robot_so101_motion.arm_session import ArmSession, Pace
from lerobot_robot_so101_motion.config import SO101MotionConfig
from lerobot_robot_so101_motion.so101_device import SO101Device
from lerobot_robot_so101_motion.units import JOINTS, KEYS, is_number
from so101_motion.common.errors import So101Error
from so101_motion.common.units import to_rad
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.files.scene_file import read_scene
from so101_motion.files.tool_file import find_tool
from so101_motion.planning.collision.scene import Scene

if TYPE_CHECKING:
    from lerobot.cameras import Camera

_log = logging.getLogger(__name__)

TAKEN = tuple(f"{joint}.taken" for joint in JOINTS)  # keys of the target that was followed last
LOG_EVERY = 1.0  # how often the log says that targets are changed or ignored [s]; chosen


class SO101Motion(SO101Device, Robot):
    """One arm with planning, guard and caps; otherwise like LeRobot's own follower.

    ``connect`` uses ``scene``, the obstacles around it.
    """

    config_class = SO101MotionConfig
    name = "so101_motion"
    stock_folder = Path(ROBOTS) / "so_follower"

    def __init__(self, config: SO101MotionConfig) -> None:
        super().__init__(config)
        self.scene = Scene() if config.scene is None else read_scene(config.scene)
        self._tool = None if config.tool is None else find_tool(config.tool)
        self._park = None if config.park is None else SavedPoses().find(config.park).q
        self.cameras: dict[str, Camera] = make_cameras_from_configs(config.cameras)
        self._wanted: dict[str, float] = {}
        self._warned_at: dict[str, float] = {}

    # Features

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        pictures: dict[str, Any] = {}
        for key, camera in self.cameras.items():
            if getattr(camera, "use_rgb", True):
                pictures[key] = (camera.height, camera.width, 3)
            if getattr(camera, "use_depth", False):
                pictures[f"{key}_depth"] = (camera.height, camera.width, 1)
        taken = dict.fromkeys(TAKEN, float) if self.config.record_taken else {}
        return {**self.action_features, **taken, **pictures}

    # Connection

    def connect(self, calibrate: bool = True) -> None:
        """Open the arm, which then holds its position, and the cameras.

        Without a calibration file it is calibrated first if ``calibrate`` says so; else the values
        in its servos are used, and the log says that. ``ConnectionError`` if it cannot be reached.
        """
        config = self.config
        pace = Pace(
            speed=to_rad(config.speed_degs_per_sec),
            acceleration=to_rad(config.acceleration_degs_per_sec_per_sec),
            approach_speed=to_rad(config.approach_speed_degs_per_sec),
            stale_after=config.stale_after_s,
            guarded=config.guard,
        )
        self._open(pace, self.scene, calibrate=calibrate, compensates=not config.stock_droop)

    def _begin(self) -> None:
        self._wanted = {}
        self.session.rig.arm.set_tool(self._tool)
        if self.config.park is not None:
            zeros = self.session.rig.connection.encoder_zeros
            self._park = SavedPoses(zeros=lambda: zeros).find(self.config.park).q
        for camera in self.cameras.values():
            camera.connect()

    def configure(self) -> None:
        """Do nothing: the servos are set up when the arm is opened."""

    # Observations and actions

    def get_observation(self) -> dict[str, Any]:
        """Read the joints' newest measurement and the newest pictures."""
        try:
            values: dict[str, Any] = dict(self.session.here)
        except So101Error as error:
            raise ConnectionError(str(error)) from error
        if self.config.record_taken:
            taken = self._wanted or values
            values |= {name: taken[key] for name, key in zip(TAKEN, KEYS, strict=True)}
        for key, camera in self.cameras.items():
            if getattr(camera, "use_rgb", True):
                values[key] = _picture(camera)
            if getattr(camera, "use_depth", False):
                values[f"{key}_depth"] = camera.read_latest_depth()
        return values

    def send_action(self, action: Mapping[str, Any]) -> dict[str, Any]:
        """Follow a target from the next control cycle on; returns that of all six joints.

        It is limited to the arm's range and ``max_relative_target``. A joint that is left out keeps
        its target. A target with a value that is not a number is ignored; without another one the
        arm slows to rest. The log says both. Keys that do not end with ``.pos`` are ignored;
        ``ValueError`` for a joint that there is not, ``ConnectionError`` if the arm cannot follow.
        """
        session = self.session
        try:
            sent = self._checked(action)
            before = self._wanted or session.here
            if sent is None:
                return dict(before)
            wanted = {**before, **sent}
            if self.config.max_relative_target is not None:
                wanted = self._near(wanted, session.here)
            taken = session.units.to_lerobot(*session.follow(*session.units.from_lerobot(wanted)))
        except So101Error as error:
            raise ConnectionError(f"{self} cannot follow: {error}") from error
        for key in KEYS:
            if abs(taken[key] - wanted[key]) > 1e-6:
                self._warn(key, "%s: %.1f was limited to %.1f", key, wanted[key], taken[key])
        if held_by := session.held_by:
            self._warn("held", "%s is held back by %s", self, " and ".join(held_by))
        self._wanted = taken
        return dict(taken)

    # End

    def disconnect(self) -> None:
        """Come to rest, move to the park pose, release a lying arm, and close the port.

        If a step fails, the arm holds, and the log says so.
        """
        session = self.session
        try:
            self._leave(session)
        finally:
            self._close()

    def _leave(self, session: ArmSession) -> None:
        try:
            session.rest()
            if self._park is not None:
                session.go(self._park)
            if not self.config.disable_torque_on_disconnect:
                return
            rest = SavedPoses().find("rest").q
            lying = (rest,) if self._park is None else (self._park, rest)
            if not session.release_where_it_lies(lying):
                _log.warning(
                    "%s goes on holding, because it would drop in this pose. Support it and switch"
                    " it off, or let it move to a pose in which it lies at the end:"
                    " --robot.park=rest",
                    self,
                )
        except So101Error as error:
            _log.warning("%s holds its position: %s", self, error)

    # Helpers

    def _close(self) -> None:
        try:
            super()._close()
        finally:
            for camera in self.cameras.values():
                if camera.is_connected:
                    camera.disconnect()

    def _checked(self, action: Mapping[str, Any]) -> dict[str, float] | None:
        """The joint values in an action; None if one is not a number."""
        sent = {key: value for key, value in action.items() if key.endswith(".pos")}
        unknown = [key for key in sent if key not in KEYS]
        if unknown:
            raise ValueError(f"{unknown[0]} is not a joint of {self}; known: {', '.join(KEYS)}")
        wrong = [key for key, value in sent.items() if not is_number(value)]
        if wrong:
            self._warn("wrong", "a target is ignored: %s is %s", wrong[0], sent[wrong[0]])
            return None
        if len(sent) < len(KEYS):
            left = [key for key in KEYS if key not in sent]
            self._warn("left out", "%s is left out; it keeps its target", ", ".join(left))
        return {key: float(value) for key, value in sent.items()}

    def _near(self, wanted: Mapping[str, float], here: Mapping[str, float]) -> dict[str, float]:
        """Targets at most ``max_relative_target`` away from ``here``."""
        most = self.config.max_relative_target
        near = {}
        for key, value in wanted.items():
            joint = key.removesuffix(".pos")
            bound = most.get(joint, math.inf) if isinstance(most, dict) else float(most or math.inf)
            off = float(np.clip(value - here[key], -bound, bound))
            near[key] = here[key] + off
            if abs(near[key] - value) > 1e-4:
                self._warn(key, "%s: %.1f was limited to %.1f, by max_relative_target", key, value,
                           near[key])  # fmt: skip
        return near

    def _warn(self, what: str, message: str, *values: object) -> None:
        """Log a warning, at most every ``LOG_EVERY`` seconds for each ``what``."""
        now = time.monotonic()
        if now - self._warned_at.get(what, -math.inf) >= LOG_EVERY:
            self._warned_at[what] = now
            _log.warning(message, *values)


def _picture(camera: Camera) -> Any:
    newest = getattr(camera, "read_latest", None)  # LeRobot 0.5 has none
    return camera.async_read() if newest is None else newest()
