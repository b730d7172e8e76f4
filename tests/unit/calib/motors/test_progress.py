"""The progress of a setup is kept from one start to the next."""

import pytest

from so101_motion.calib.motors.setup_view import SetupProgress


def test_a_setup_goes_on_where_it_ended_and_without_a_place_to_write_only_memory_is_lost(tmp_path):
    path = tmp_path / "new" / "setup.json"
    SetupProgress(path, "/dev/a").add("gripper")
    progress = SetupProgress(path, "/dev/a")
    assert progress.done == ["gripper"]
    progress.add("gripper")
    progress.add("wrist_roll")
    assert SetupProgress(path, "/dev/a").done == ["gripper", "wrist_roll"]
    progress.clear()
    assert SetupProgress(path, "/dev/a").done == []
    (tmp_path / "file").write_text("")
    progress = SetupProgress(tmp_path / "file" / "setup.json", "/dev/a")
    progress.add("gripper")
    progress.reach("full", "motors")
    assert progress.done == ["gripper"]
    progress.clear()


def test_step_and_port_are_found_again_without_arguments(tmp_path):
    path = tmp_path / "setup.json"
    progress = SetupProgress(path, None)
    assert (progress.port, progress.workflow, progress.step) == ("", "", "")
    progress.reach("full", "connect")
    progress.work_on("/dev/a")
    progress.reach("full", "motors")
    progress.add("gripper")
    again = SetupProgress(path, None)
    assert (again.port, again.workflow, again.step) == ("/dev/a", "full", "motors")
    assert again.done == ["gripper"]
    # The motors of another port are another kit's.
    assert SetupProgress(path, "/dev/b").done == []
    progress = SetupProgress(path, None)
    progress.work_on("/dev/b")
    assert progress.done == []
    assert SetupProgress(path, "/dev/a").done == []


@pytest.mark.parametrize(
    "content", ["", "{", "[]", '"x"', "{}", '{"port": "/dev/a", "done": 3}', '{"port": "/dev/a"}']
)
def test_a_file_that_makes_no_sense_is_no_progress(tmp_path, content):
    (tmp_path / "setup.json").write_text(content)
    for port in ("/dev/a", None):
        progress = SetupProgress(tmp_path / "setup.json", port)
        assert (progress.done, progress.workflow, progress.step) == ([], "", "")
