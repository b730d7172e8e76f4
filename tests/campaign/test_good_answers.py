from campaign.good_answers import run


def test_right_answers_of_roughly_handled_joints_are_not_doubted():
    answers, doubted, fastest = run(2000, seed=1)
    assert answers >= 2000
    assert fastest > 100.0
    assert doubted == 0
