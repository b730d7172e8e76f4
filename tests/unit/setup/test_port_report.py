import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.common.state import ARM_JOINTS, GRIPPER_JOINT
from so101_motion.drivers.port.port_list import FoundPort
from so101_motion.setup import connect
from so101_motion.setup.discovery import PortReport
from so101_motion.viam.component_config import HardwareArmConfig, HardwareGripperConfig

PORT = FoundPort(name="/dev/serial/by-id/usb-58CD", device="/dev/ttyACM0", key="58CD")
ALL = (*ARM_JOINTS, GRIPPER_JOINT)


pytestmark = pytest.mark.usefixtures("data")


def report(joints=ALL, **more):
    ids = tuple(range(1, 1 + len(joints)))
    return PortReport(port=PORT, sentence="", joints=joints, servo_ids=ids, **more)


def by_model(found):
    return {one.model.rpartition(":")[2]: one for one in found.suggestions}


def test_an_arm_with_a_name_has_a_file_of_that_name_and_never_another_arms(data, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(data))
    bare = report(())
    assert connect.calibration_file(bare).name == "58CD_calibration.json"
    leader = connect.calibration_file(bare, " leader ")
    assert leader.name == "leader_calibration.json"
    leader.parent.mkdir(parents=True, exist_ok=True)
    leader.write_text("{}")
    with pytest.raises(ConfigError, match="another arm's already"):
        connect.calibration_file(bare, "leader")
    assert connect.calibration_file(report((), calibration=leader), "leader") == leader
    for name in ("../leader", "a/b", ".hidden", "con", "x" * 41):
        with pytest.raises(ConfigError, match="arm name"):
            connect.calibration_file(bare, name)


def test_all_three_name_one_file_as_it_is_called_there_and_without_it_only_the_sensor_does(data):
    found = by_model(report())
    assert found["arm"].attributes == {"port": PORT.name}
    assert found["gripper"].attributes == {"port": PORT.name}
    own = {"port": PORT.name, "calibration_file": "58CD_calibration.json"}
    assert found["calibration"].attributes == own
    found = by_model(report(calibration=data / "mine.json"))
    assert {one.attributes["calibration_file"] for one in found.values()} == {"mine.json"}
    for elsewhere in (data.parent / "elsewhere.json", data / "deeper" / "x.json"):
        found = by_model(report(calibration=elsewhere))
        assert {one.attributes["calibration_file"] for one in found.values()} == {str(elsewhere)}


def test_what_is_configured_already_or_has_not_all_its_servos_is_not_suggested():
    found = by_model(report(configured=frozenset({"arm", "calibration"}), arm_name="blue"))
    assert set(found) == {"gripper"}
    assert found["gripper"].frame == {"parent": "blue"}
    assert set(by_model(report(ARM_JOINTS))) == {"arm", "calibration"}
    assert set(by_model(report((*ARM_JOINTS[:4], GRIPPER_JOINT)))) == {"calibration"}
    assert set(by_model(PortReport(port=PORT, sentence="", servo_ids=(1,)))) == {"calibration"}
    assert PortReport(port=PORT, sentence="nobody").suggestions == ()


def test_what_is_suggested_of_a_leader_at_another_rate_is_accepted(data):
    found = by_model(report(role="leader", baudrate=500_000, calibration=data / "a.json"))
    HardwareArmConfig.from_attributes(found["arm"].attributes)
    HardwareGripperConfig.from_attributes(found["gripper"].attributes)
    assert found["gripper"].attributes["gripper_type"] == "leader"
    assert "gripper_type" not in by_model(report(role="follower"))["gripper"].attributes
