import numpy as np
import pytest

from so101_motion.control.following_check import FollowingCheck, LatestRows
from so101_motion.control.joint_group import Tolerances

DT = 0.01
TOLERANCES = Tolerances(
    following_lag=0.15,
    contact_distance=np.radians(1.6),
    pressed_stray=np.radians(0.5),
)


IN_PLAY = 0.8  # how far an emulated joint falls behind in its play at 10 deg/s, and a margin [deg]


def seen(setpoints, joints, tolerances=TOLERANCES, pressed_from=1000, in_play=IN_PLAY):
    """At which tick a joint that goes through ``joints`` [deg] is held up; None if never."""
    check = FollowingCheck(tolerances, DT)
    check.begin(np.radians(setpoints[:1]))
    for k, (setpoint, joint) in enumerate(zip(setpoints, joints, strict=True)):
        check.want(np.radians([setpoint]))
        if check.held_up(np.radians([joint]), np.radians([in_play * (k < pressed_from)]))[0]:
            return k
    return None


@pytest.mark.parametrize("speed", [25.0, -25.0, 90.0, 180.0])
def test_a_joint_that_meets_something_is_held_up_within_90_ms(speed):
    way = speed * DT * np.arange(100.0)
    met = 50
    assert met < seen(way, np.where(np.arange(100) < met, way, way[met])) <= met + 9


@pytest.mark.parametrize(("speed", "ticks"), [(10.0, 9), (-10.0, 9), (15.0, 6), (20.0, 5)])
def test_one_that_followed_slowly_is_held_up_once_it_stands_longer_than_play_lets_it(speed, ticks):
    way = speed * DT * np.arange(150.0)
    met = 80
    stands = np.where(np.arange(150) < met, way, way[met])
    assert met < seen(way, stands) <= met + ticks


@pytest.mark.parametrize(("speed", "ticks"), [(8.0, 8), (-10.0, 6), (15.0, 5), (20.0, 5)])
def test_one_whose_load_stays_on_one_side_is_held_up_sooner(speed, ticks):
    way = speed * DT * np.arange(150.0)
    stands = np.where(np.arange(150) < 80, way, way[80])
    assert 80 < seen(way, stands, pressed_from=0) <= 80 + ticks


def test_one_whose_load_came_to_that_side_just_now_may_stand_for_its_play():
    way = 10.0 * DT * np.arange(200.0)
    crossing = np.maximum(np.minimum(way, way[100]), way - 0.75)
    assert seen(way, crossing, pressed_from=95) is None
    assert seen(way, crossing, pressed_from=0) is not None


def test_one_that_fell_through_its_play_waits_for_its_motor_though_its_load_was_on_one_side():
    # As an emulated shoulder_lift did near the place where it balances.
    way = 5.0 * DT * np.arange(200.0)
    falls = way.copy()
    falls[100:103] = way[100] + 0.9
    falls[103:] = np.maximum(way[100] + 0.6, way[103:] - 0.75)
    assert seen(way, falls, pressed_from=0) is None
    met = np.minimum(way, way[100])
    assert seen(way, met, pressed_from=0) is not None


@pytest.mark.parametrize("speed", [5.0, 10.0, 20.0, 30.0])
@pytest.mark.parametrize("in_play", [0.6, 0.8, 1.0])
def test_one_whose_load_changes_sides_on_its_way_stands_for_its_play(speed, in_play):
    way = speed * DT * np.arange(200.0)
    crossing = np.maximum(np.minimum(way, way[100]), way - 0.99 * in_play)
    assert seen(way, crossing, in_play=in_play) is None


def test_one_whose_load_turns_round_while_it_stands_falls_back_on_its_motor():
    way = 7.0 * DT * np.arange(100.0)
    crossing = np.maximum(np.minimum(way, way[70]), way - 0.1)
    crossing[70:81] = way[70]
    crossing[78:81] = way[70] - np.array(
        [0.27, 0.0, -0.17]
    )  # an emulated one, with 1.02 deg of play
    assert seen(way, crossing) is None


def test_one_that_trembles_at_what_it_met_is_held_up():
    way = 10.0 * DT * np.arange(120.0)
    joint = np.where(np.arange(120) < 80, way, way[80])
    joint[80:90] += [0.0, -0.09, 0.0, 0.09, -0.09, 0.0, 0.09, 0.0, 0.18, 0.18]
    joint[90:] += 0.26
    assert 80 < seen(way, joint) <= 80 + 11


def way(speed, ticks):
    return speed * DT * np.arange(float(ticks))


TURN = np.abs(np.linspace(-30.0, 30.0, 120))
STOPPING = -np.array([67.4, 68.0, 68.7, 69.2, 69.8, 70.3, 70.8, 71.2, 71.6, 71.9, 72.3, 72.6,
                      72.8, 73.0, 73.2, 73.4, 73.5, 73.6, 73.7, 73.8, 73.8])  # fmt: skip
ARRIVING = np.concatenate([np.linspace(-15.0, STOPPING[0], 50), STOPPING])
SOFT = {"tolerances": Tolerances(following_lag=0.15)}


@pytest.mark.parametrize(
    ("setpoints", "joint", "options"),
    [
        (way(10.0, 200), 0.4 * np.floor(way(10.0, 200) / 0.4), {"pressed_from": 0}),
        (TURN, np.where(np.arange(120) < 60, TURN, np.maximum(TURN - 1.3, 0.0)), {}),
        (way(50.0, 60), np.minimum(way(50.0, 60) + 4.0, np.maximum(way(50.0, 60), 20.0)), {}),
        (ARRIVING, np.maximum(ARRIVING - 1.0, -72.9), {}),
        (way(15.0, 60), way(15.0, 60) - np.linspace(0.0, 1.0, 60) * 1.2, {}),
        (way(90.0, 100), np.minimum(way(90.0, 100), 40.0), SOFT),
    ],
    ids=[
        "sticks and slips by little",
        "loses its play at a turn",
        "ran ahead and waits for its setpoints",
        "ran ahead and stands where they come to rest, an emulated shoulder from 120 deg/s",
        "falls back",
        "shall be stopped by what it meets, and presses",
    ],
)
def test_a_joint_that_has_met_nothing_is_not_held_up(setpoints, joint, options):
    assert seen(setpoints, joint, **options) is None


@pytest.mark.parametrize("lag", [0, 5, 10, 14])
def test_a_joint_that_lags_by_a_constant_time_is_not_held_up(lag):
    t = DT * np.arange(400.0)
    way = 60.0 * np.cos(2.5 * t)  # up to 150 deg/s
    late = np.concatenate([np.full(lag, way[0]), way[: len(way) - lag]])
    assert seen(way, late) is None


def test_the_latest_rows_are_those_of_a_list_however_many_came():
    rows, kept = LatestRows(7), []
    for k in range(100):
        rows.append(np.array([k, -k], dtype=float))
        kept = [*kept, [k, -k]][-7:]
        assert rows.last(7).tolist() == kept
        assert rows.last(3).tolist() == kept[-3:]
        assert len(rows) == len(kept)
    rows.clear()
    assert len(rows) == len(rows.last(7)) == 0
    rows.append(np.array([1.0, 2.0]))
    assert rows.last(7).tolist() == [[1.0, 2.0]]


def told_in_silence(missed, ticks, speed=15.0, tolerances=TOLERANCES):
    """What is said of a joint whose servo is silent for ``ticks`` and may miss its goals."""
    check, way = FollowingCheck(tolerances, DT), np.radians(speed * DT * np.arange(150.0))
    check.begin(way[:1])
    for k, setpoint in enumerate(way):
        silent = 80 <= k < 80 + ticks
        behind = min(max(k - 80, 0), ticks) * (way[1] - way[0]) if missed else 0.0
        check.want(np.array([setpoint]))
        q = setpoint if silent else setpoint - behind
        if check.held_up(np.array([q]), np.array([np.radians(IN_PLAY)]), silent=silent)[0]:
            return check.words(0, held_up=True)
    return None


def test_joints_that_get_their_goals_in_a_silence_go_on():
    assert told_in_silence(missed=False, ticks=20) is None


@pytest.mark.parametrize("speed", [15.0, 45.0, -90.0])
def test_joints_that_miss_a_few_goals_go_on(speed):
    assert told_in_silence(missed=True, ticks=4, speed=speed) is None


@pytest.mark.parametrize("speed", [15.0, 45.0, -90.0])
def test_joints_that_miss_many_goals_are_told(speed):
    happened, to_check = told_in_silence(missed=True, ticks=7, speed=speed)
    assert happened == "missed its goals while no servo answered for 0.07 s, and is"
    assert "USB cable" in to_check


def off_after_late_ticks(joint_speed, gap, since):
    """How far a joint at 120 deg/s is off that ran on for ``gap`` [s] without setpoints [deg].

    Its setpoints go on for ``since`` [s] then; the joint keeps ``joint_speed`` [deg/s] meanwhile.
    """
    check, speed = FollowingCheck(TOLERANCES, DT), np.radians([120.0])
    check.begin(np.zeros(1))
    for k in range(50):
        check.want(k * DT * speed)
        check.off(k * DT * speed)
    wanted = 49 * DT * speed
    check.run_on(wanted, speed, gap)
    joint = wanted + gap * np.radians([joint_speed])
    for _ in range(round(since / DT)):
        wanted, joint = wanted + DT * speed, joint + DT * np.radians([joint_speed])
        check.want(wanted)
        off = check.off(joint)
    return float(np.degrees(off[0])), check.words(0, held_up=False)


def test_a_joint_that_ran_on_while_no_setpoint_was_sent_is_not_off():
    off, _ = off_after_late_ticks(120.0, gap=0.1, since=DT)
    assert off == pytest.approx(1.2), "what it has run on since"


def test_one_that_is_still_ahead_long_after_is_off_and_the_late_tick_is_named():
    off, words = off_after_late_ticks(140.0, gap=0.1, since=0.25)
    assert off > 8.0
    assert words == ("was without setpoints for 0.10 s, and is", "how busy the computer is")
    off, words = off_after_late_ticks(120.0, gap=0.1, since=0.5)
    assert off == pytest.approx(12.0)
    assert words[0] == "is"


def test_one_that_ran_on_for_longer_than_servos_need_to_their_goals_is_off():
    off, words = off_after_late_ticks(120.0, gap=0.2, since=DT)
    assert off == pytest.approx(12.0 + 1.2), "beyond a tenth of a second, and since"
    assert words[0] == "was without setpoints for 0.20 s, and is"


def test_one_that_stopped_while_no_setpoint_was_sent_is_off():
    off, words = off_after_late_ticks(0.0, gap=0.05, since=0.25)
    assert off == pytest.approx(12.0, abs=0.1), "behind all setpoints of the last 0.15 s"
    assert words[0] == "is"
