from so101_motion.calib.record.record import JOINTS
from so101_motion.common.operation import Picture
from so101_motion.setup.assembly import AssemblyOperation


def test_each_joint_is_shown_swinging_until_all_are_right():
    now = [0.0]
    check = AssemblyOperation(lambda: now[0])
    assert check.view.rows[0].text.startswith("Motor 1 turns the arm on its base. Turn it by hand")
    for k, joint in enumerate(JOINTS):
        now[0] += 0.75
        picture: Picture = check.view.picture
        assert picture.lit == (joint,)
        assert [i for i in range(5) if picture.q[i]] == ([k] if k < 5 else [])
        assert (picture.q[5] > 0.6) is (joint == "gripper")
        assert not check.view.is_over
        check.ask("accept", **check.view.offers[0].arguments)
    assert check.view.is_over
    check.ask("look_at", joint="elbow_flex")
    assert check.view.rows[2].mark == "●"
    now[0] += 60.0
    assert not any(check.view.picture.q[:5]), "it swings for a while only"
