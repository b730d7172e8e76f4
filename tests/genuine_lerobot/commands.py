"""LeRobot's own commands on emulated arms, through the plugin: ``make test-lerobot``.

Everything here is real: LeRobot from the package index, its commands as processes, ports, time. The
arms are emulated. What came of it is written to ``benchmarks/results/lerobot_commands.json``. On a
busy machine processes may be late for each other; then it is run again.
"""

import argparse
import importlib.metadata
import json
import os
import platform
import pty
import signal
import struct
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from bench import ROOT, Bench, Failure

from so101_motion.planning.goals import JointGoal
from so101_motion.rig.simulated_rig import open_simulated
from so101_motion.tasks.datasets.episodes import EpisodeOperation

RESULTS = ROOT / "benchmarks" / "results" / "lerobot_commands.json"
CAMERA = "{front: {type: fake, width: 96, height: 96, fps: 30}}"
DROPPED = 8.0  # [deg] that a joint may move after the end; from rest on the forearm sinks by six


def robot(arm, *more):
    return (
        "--robot.type=so101_motion", f"--robot.port={arm.port}", "--robot.id=arm",
        "--robot.park=rest", *more,
    )  # fmt: skip


def leader(arm):
    return (
        "--teleop.type=so101_motion_leader", f"--teleop.port={arm.port}", "--teleop.id=leader"
    )  # fmt: skip


# Each: a sentence, and what it found


def setup_motors(bench):
    """lerobot-setup-motors gives a new kit its ids."""
    joints = ("gripper", "wrist_roll", "wrist_flex", "elbow_flex", "shoulder_lift", "shoulder_pan")
    with bench.arm("kit", "--new") as kit:
        running = bench.begin(
            "setup-motors", "--robot.type=so101_motion", f"--robot.port={kit.port}"
        )
        for joint in joints:
            running.await_text(f"'{joint}' motor only")
            kit.type(f"only:{joint}")
            time.sleep(1.5)
            running.enter()
            running.await_text(f"'{joint}' motor id set")
        running.end(20)


def calibrate(bench, kind="robot", name="arm"):
    """lerobot-calibrate records an arm; LeRobot reads the file."""
    arguments = robot if kind == "robot" else leader
    with bench.arm(name) as arm:
        running = bench.begin("calibrate", *arguments(arm))
        running.await_text("press ENTER")
        arm.type("pose")
        time.sleep(3.0)
        running.enter()
        running.await_text("Press ENTER to stop")
        arm.type("sweep")
        time.sleep(32.0)
        running.enter()
        running.await_text("Calibration saved")
        running.end(40)
    group = "robots/so_follower" if kind == "robot" else "teleoperators/so_leader"
    file = bench.folder / "lerobot" / "calibration" / group / f"{name}.json"
    entries = json.loads(file.read_text())
    fields = {"id", "drive_mode", "homing_offset", "range_min", "range_max"}
    if len(entries) != 6 or any(set(entry) != fields for entry in entries.values()):
        raise Failure(f"LeRobot would not read {entries}")


def calibrate_leader(bench):
    """lerobot-calibrate records a leader."""
    calibrate(bench, "teleop", "leader")


@contextmanager
def both(bench):
    """A follower, and a leader that a hand holds up, and sweeps when "sweep" is typed."""
    with bench.arm("arm") as arm, bench.arm("leader") as leading:
        leading.type("pose")
        yield arm, leading


def teleoperate(bench):
    """lerobot-teleoperate at 60 Hz for 40 s."""
    with both(bench) as (arm, leading):
        running = bench.begin(
            "teleoperate", *robot(arm), *leader(leading), "--fps=60", "--teleop_time_s=40"
        )
        running.await_text("Teleop loop time")
        leading.type("sweep")
        running.end(90)
        loops = running.said.count("Teleop loop time")
        return {"loops": loops, "dropped_deg": arm.dropped()}


def _jog(bench, device, hold, stdin=subprocess.PIPE):
    """Hold something for three seconds; which joints it moved, and how the command ended."""
    with bench.arm("arm") as arm:
        before = arm.degrees()
        running = bench.begin(
            "teleoperate", "--robot.type=so101_motion", f"--robot.port={arm.port}",
            "--robot.id=arm", "--teleop.type=so101_motion_jog", f"--teleop.device={device}",
            "--fps=30", stdin=stdin,
        )  # fmt: skip
        running.await_text("Teleop loop time")
        for _ in range(75):
            hold()
            time.sleep(0.04)
        running.send(signal.SIGINT)
        running.end(30)
        moved = np.abs(arm.degrees() - before).round(1).tolist()
        if max(moved) < 5.0:
            told = [line for line in running.said.splitlines() if "loop time" not in line]
            raise Failure(f"nothing moved: {moved}; {told}")
        return {"moved_deg": moved, "dropped_deg": arm.dropped()}


def jog_with_keys(bench):
    """lerobot-teleoperate with keys of its terminal: the tool goes up while R is held."""
    ours, theirs = pty.openpty()
    try:
        return _jog(bench, "keyboard", lambda: os.write(ours, b"r"), theirs)
    finally:
        os.close(ours)
        os.close(theirs)


def jog_with_a_gamepad(bench):
    """lerobot-teleoperate with a gamepad's events: the tool goes up while its stick is held."""
    pad = bench.folder / "js0"
    os.mkfifo(pad)
    end = os.open(pad, os.O_RDWR)
    events = struct.pack("=IhBB", 0, 1, 1, 5) + struct.pack("=IhBB", 0, -32767, 2, 4)
    try:
        return _jog(bench, pad, lambda: os.write(end, events))
    finally:
        os.close(end)


def _ended_by(bench, number, code):
    with both(bench) as (arm, leading):
        running = bench.begin("teleoperate", *robot(arm), *leader(leading), "--fps=60")
        running.await_text("Teleop loop time")
        time.sleep(3.0)  # it has come to the leader's pose
        leading.type("sweep")
        time.sleep(4.7)  # the base is on its way from one stop to the other
        running.send(number)
        took = running.end(30, code)
        here = arm.degrees()
        time.sleep(1.0)  # nobody is left to tell its servos to stop short of their goals
        went_on = float(np.abs(arm.degrees() - here).max())
        return {
            "ended_after_s": round(took, 2),
            "went_on_deg": round(went_on, 1),
            "pan_deg": round(float(here[0]) - 180.0, 1),
            "dropped_deg": arm.dropped(),
        }


def interrupted(bench):
    """Ctrl-C in mid-motion: it parks and lets go."""
    return _ended_by(bench, signal.SIGINT, 0)


def terminated(bench):
    """SIGTERM in mid-motion: it parks and lets go."""
    return _ended_by(bench, signal.SIGTERM, 128 + signal.SIGTERM)


def killed(bench):
    """SIGKILL in mid-motion: it goes on to its servos' last goals and holds there."""
    found = _ended_by(bench, signal.SIGKILL, -signal.SIGKILL)
    if not 8.0 < abs(found["pan_deg"]) < 95.0:
        raise Failure(f"it was not on its way between the stops: {found}")
    return found


def _dataset(bench, name):
    return (f"--dataset.repo_id=somebody/{name}", f"--dataset.root={bench.folder / name}")


def record(bench):
    """lerobot-record with a camera."""
    with both(bench) as (arm, leading):
        running = bench.begin(
            "record", *robot(arm, f"--robot.cameras={CAMERA}"), *leader(leading),
            *_dataset(bench, "seen"), "--dataset.num_episodes=1", "--dataset.episode_time_s=25",
            "--dataset.fps=30", "--dataset.single_task=wave", "--dataset.push_to_hub=false",
            "--play_sounds=false",
        )  # fmt: skip
        running.await_text("Recording episode")
        leading.type("sweep")
        running.end(150)
        info = json.loads((bench.folder / "seen" / "meta" / "info.json").read_text())
        return {"frames": info["total_frames"], "dropped_deg": arm.dropped()}


def replay(bench):
    """lerobot-replay of that recording; the first frame is approached."""
    with bench.arm("arm") as arm:
        running = bench.run(
            "replay", *robot(arm), *_dataset(bench, "seen"), "--dataset.episode=0",
            "--play_sounds=false", within=150,
        )  # fmt: skip
        if "Replaying episode" not in running.said:
            raise Failure(running.said[-600:])
        return {"dropped_deg": arm.dropped()}


def _policy(bench, *kind):
    """A policy of this kind in a folder of its own."""
    folder = bench.folder / kind[0]
    made = subprocess.run(
        [sys.executable, Path(__file__).with_name("make_policy.py"), folder, *kind],
        env=bench.env, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if made.returncode:
        raise Failure(made.stderr[-900:])
    return folder


def _rollout(bench, arguments, *more):
    """Let a policy act for 15 s; what was said, and how far the arm dropped."""
    with bench.arm("arm") as arm:
        before = arm.degrees()
        running = bench.run(
            "rollout", *arguments(arm), *more, "--policy.device=cpu", "--strategy.type=base",
            "--task=wave", "--duration=15", within=150,
        )  # fmt: skip
        moved = np.abs(arm.degrees() - before).round(1).tolist()
        return running.said, {"moved_deg": moved, "dropped_deg": arm.dropped()}


def rollout(bench):
    """lerobot-rollout of a policy with random weights, for 15 s; it goes home and parks."""
    policy = _policy(bench, "act", bench.folder / "seen")
    _, found = _rollout(
        bench, lambda arm: robot(arm, f"--robot.cameras={CAMERA}"), f"--policy.path={policy}"
    )
    return found


def _stays(arm):
    """A robot that is left where its policy took it."""
    return robot(arm)[:-1]


def rollout_in_chunks(bench):
    """lerobot-rollout, real-time chunks that come 0.5 s late, two interpolated steps for each."""
    policy = _policy(bench, "wave")
    said, found = _rollout(
        bench, _stays, f"--policy.path={policy}", "--inference.type=rtc",
        "--interpolation_multiplier=2", "--return_to_initial_position=false",
    )  # fmt: skip
    if max(found["moved_deg"]) < 20.0 or "RTC inference error" in said:
        raise Failure(f"{found}; {said[-900:]}")
    return found


def rollout_of_garbage(bench):
    """lerobot-rollout of a policy that jumps by 60 deg and says NaN and 5000 deg."""
    policy = _policy(bench, "garbage")
    said, found = _rollout(
        bench, _stays, f"--policy.path={policy}", "--return_to_initial_position=false"
    )
    if "a target is ignored" not in said:
        raise Failure(f"no warning that NaN was ignored: {said[-900:]}")
    return found


def recorded_types(bench):
    """What make test has in LeRobot's place has the same names and arguments."""
    subprocess.run(
        [sys.executable, Path(__file__).with_name("compare_types.py")], env=bench.env, check=True
    )


def film_from_the_page(bench):
    """The Record tab films two episodes with a camera; LeRobot loads them, the arm replays."""
    sys.path.append(str(ROOT / "tests"))
    from harness.web_camera import web_camera
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    folder = bench.folder / "film"
    with open_simulated() as rig, web_camera() as address:
        operation = EpisodeOperation(rig)
        try:
            for goal in (np.radians([30.0, -20.0, 20.0, 10.0, 0.0]), np.zeros(5)):
                operation.ask(
                    "record", data_set=str(folder), task="wave", camera=f"{address}/live", fps="30"
                )
                rig.arm.move(JointGoal(q=goal))
                time.sleep(1.0)
                kept = operation.ask("keep")
            replayed = operation.ask("replay")
        finally:
            operation.close()
    data_set = LeRobotDataset("somebody/film", root=folder)
    frame, told = data_set[len(data_set) - 1], {"task": "wave", "episode_index": 1}
    if data_set.num_episodes != 2 or frame["observation.images.front"].shape != (3, 24, 32):
        raise Failure(f"it is not what was filmed: {data_set}")
    if any(frame[key] != value for key, value in told.items()):
        raise Failure(f"its last frame is {frame}")
    return {"frames": len(data_set), "late": kept["late"], "off_deg": replayed["rms_deg"]}


SCENARIOS = (
    recorded_types, setup_motors, calibrate, calibrate_leader, teleoperate, interrupted,
    terminated, killed, jog_with_keys, jog_with_a_gamepad, record, replay, film_from_the_page,
    rollout, rollout_in_chunks, rollout_of_garbage,
)  # fmt: skip
NEEDED = (calibrate, calibrate_leader)


def versions():
    names = ("lerobot", "torch", "numpy", "packaging", "pillow", "so101-motion")
    return {name: importlib.metadata.version(name) for name in names} | {
        "python": platform.python_version()
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", help="which, by name; calibrations come along")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--patience", type=float, default=1.0, help="wait so many times as long")
    asked = parser.parse_args()
    Bench.patience = asked.patience
    # In the background of a script it is ignored, and the commands would not hear it either.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    chosen = [each for each in SCENARIOS if not asked.only or each.__name__ in asked.only]
    if asked.only:
        chosen = list(dict.fromkeys([*NEEDED, *chosen]))
    priority = ["chrt", "-r", "5"] if os.geteuid() == 0 else []
    told, failed = {"versions": versions(), "scenarios": {}}, 0
    with tempfile.TemporaryDirectory(prefix="lerobot-") as folder:
        bench = Bench(Path(folder), priority)
        for scenario in chosen:
            begin, found = time.monotonic(), {}
            try:
                found = scenario(bench) or {}
                if found.get("dropped_deg", 0.0) > DROPPED:
                    raise Failure(f"the arm dropped: {found}")
            except (Failure, subprocess.SubprocessError) as error:
                failed += 1
                found = {"failed": str(error)}
            seconds = round(time.monotonic() - begin, 1)
            said = {"what": scenario.__doc__, **found, "seconds": seconds}
            told["scenarios"][scenario.__name__] = said
            print(json.dumps(said), flush=True)
    with suppress(FileNotFoundError):
        if asked.only:
            before = json.loads(asked.results.read_text())
            told["scenarios"] = before["scenarios"] | told["scenarios"]
    asked.results.write_text(json.dumps(told, indent=1) + "\n")
    print(f"{failed} of {len(chosen)} failed; see {asked.results}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
