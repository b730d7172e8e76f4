from so101_motion.drivers.unseen import Unseen


def test_a_joint_that_is_not_seen_is_taken_to_follow_its_goals():
    unseen = Unseen(2)
    unseen.note(1, 0.48, [0.0, 0.5])
    assert unseen.stand_in(1, [0.0, 0.5]) == 0.48
    assert unseen.stand_in(1, [0.0, 0.7]) == 0.48 + 0.7 - 0.5


def test_a_limp_joint_is_where_it_was_seen():
    unseen = Unseen(1)
    unseen.note(0, 0.3, None)
    assert unseen.stand_in(0, [0.9]) == 0.3
    unseen.note(0, 0.4, [0.4])
    assert unseen.stand_in(0, None) == 0.4
