"""What a user keeps has the zeros of the arm's calibration and is converted to those of another."""

import json

import numpy as np
import pytest

from so101_motion.common.encoder_zeros import EncoderZero
from so101_motion.common.errors import ConfigError
from so101_motion.common.state import ARM_JOINTS
from so101_motion.files.saved_poses import SavedPoses
from so101_motion.tasks.guided import GuidedPath
from so101_motion.tasks.guided import files as paths
from so101_motion.tasks.program import ARM, Program, Waypoint, files

Q = np.radians([10.0, -40.0, 35.0, 60.0, 0.0])
OLD = {
    joint: EncoderZero(direction=direction, ticks=ticks)
    for joint, direction, ticks in zip(
        ARM_JOINTS, (1, -1, 1, 1, 1), (4090.0, 2000.0, 2047.0, 2047.0, 2047.0), strict=True
    )
}
ANEW = OLD | {
    "shoulder_pan": EncoderZero(direction=1, ticks=50.0),  # 56 ticks on, past the turn
    "shoulder_lift": EncoderZero(direction=-1, ticks=2056.0),
}
DIFFERENCE_DEG = 56 * 360.0 / 4096
SAME_PLACE = np.degrees(Q) + DIFFERENCE_DEG * np.array([-1.0, 1.0, 0.0, 0.0, 0.0])
OTHER_ARM = OLD | {"elbow_flex": EncoderZero(direction=1, ticks=2247.0)}
TURNED = OLD | {"elbow_flex": EncoderZero(direction=-1, ticks=2047.0)}

WAYPOINT = Waypoint(name="mug", q=Q)


class Pose:
    name = "mug"

    def write(self, folder, zeros):
        SavedPoses(folder / "poses.json", lambda: zeros).save("cup", Q)
        SavedPoses(folder / "poses.json").rename("cup", "mug")
        return folder / "poses.json"

    def read(self, file, zeros):
        return SavedPoses(file, lambda: zeros).find("mug").q


class OneArm:
    name = ""

    def write(self, folder, zeros):
        files.write(Program.of_waypoints((WAYPOINT,)), folder / "wave.json", {ARM: zeros})
        return folder / "wave.json"

    def read(self, file, zeros):
        return files.read(file, {ARM: zeros}).waypoints[0].q


class OlderArm(OneArm):
    """A file of before, with waypoints and the zeros beside them."""

    def write(self, folder, zeros):
        file = super().write(folder, zeros)
        content = json.loads(file.read_text())
        content |= content.pop("arms", {}).get(ARM, {})
        content["waypoints"] = [each[ARM] for each in content.pop("steps")]
        content["schema"] = f"so101/program/{1 if zeros is None else 2}"
        file.write_text(json.dumps(content))
        return file


class Arms:
    name = "left"

    def write(self, folder, zeros):
        steps = ({"left": WAYPOINT, "right": WAYPOINT},)
        files.write(Program(steps=steps), folder / "wave.json", {"left": zeros})
        return folder / "wave.json"

    def read(self, file, zeros):
        step = files.read(file, {"left": zeros, "right": zeros}).steps[0]
        np.testing.assert_allclose(step["right"].q, Q, atol=1e-6)  # not known
        return step["left"].q


class OlderArms(Arms):
    """A file of before, which had another schema."""

    def write(self, folder, zeros):
        file = super().write(folder, zeros)
        older = f"so101/cell-program/{1 if zeros is None else 2}"
        file.write_text(file.read_text().replace(files.SCHEMA, older))
        return file


class Guided:
    name = ""

    def write(self, folder, zeros):
        path = GuidedPath(t=np.array([0.0, 1.0]), q=np.array([Q, Q]), aperture=np.zeros(2))
        paths.write(path, folder / "wave.json", zeros=zeros)
        return folder / "wave.json"

    def read(self, file, zeros):
        return paths.read(file, zeros).q[1]


@pytest.fixture(params=[Pose, OneArm, OlderArm, Arms, OlderArms, Guided])
def kind(request):
    return request.param()


@pytest.mark.parametrize(
    ("made_with", "now", "expected_deg"),
    [
        (OLD, OLD, np.degrees(Q)),
        (OLD, ANEW, SAME_PLACE),
        (OLD, None, np.degrees(Q)),
        (None, ANEW, np.degrees(Q)),
    ],
)
def test_arm_stands_where_it_did(kind, tmp_path, made_with, now, expected_deg):
    file = kind.write(tmp_path, made_with)
    np.testing.assert_allclose(np.degrees(kind.read(file, now)), expected_deg, atol=2e-4)
    assert ('"encoder_zeros"' in file.read_text()) == (made_with is not None)


@pytest.mark.parametrize(
    ("now", "differs"),
    [(OTHER_ARM, r"elbow_flex -17\.6 deg"), (TURNED, "elbow_flex turns the other way")],
)
def test_another_arm_is_refused_until_the_user_accepts_it(so101, kind, tmp_path, now, differs):
    file = kind.write(tmp_path, OLD)
    with pytest.raises(ConfigError, match=differs) as refused:
        kind.read(file, now)
    words = [file, *(["--name", kind.name] if kind.name else [])]
    assert f'accept "{file}"' in str(refused.value)
    assert kind.name in str(refused.value)
    assert so101("calibration accept", *words).exit_code == 0
    np.testing.assert_allclose(kind.read(file, now), Q, atol=1e-6)
    assert so101("calibration accept", *words).exit_code == 2


def test_a_conversion_is_told(tmp_path, caplog):
    OneArm().read(OneArm().write(tmp_path, OLD), ANEW)
    assert "converted: shoulder_pan -4.9 deg, shoulder_lift +4.9 deg" in caplog.text


@pytest.mark.parametrize("wrong", ["[]", '{"shoulder_pan": 3}', "7"])
def test_zeros_that_are_none_are_refused(tmp_path, wrong):
    file = tmp_path / "wave.json"
    file.write_text(f'{{"schema": "so101/program/2", "waypoints": [], "encoder_zeros": {wrong}}}')
    with pytest.raises(ConfigError, match="encoder_zeros: shoulder_pan"):
        files.read(file)
