"""Kill a process that writes a file at every step it takes in the file system.

Run as a script: ``killed_writer.py FOLDER WHAT``. In ``FOLDER/0``, ``FOLDER/1`` ... it prepares the
state before, and kills a child that does WHAT at its n-th step, until one gets to the end.
"""

import itertools
import os
import sys
from pathlib import Path

from so101_motion.calib.record import store
from so101_motion.calib.record.record import JointCalibration
from so101_motion.calib.record.zero import Zero

ELBOW, JAW = "elbow_flex", "gripper"
OLD = {ELBOW: JointCalibration(id=3, homing_offset=5, range_min=948, range_max=3146)}
NEW = {ELBOW: JointCalibration(id=3, homing_offset=9, range_min=940, range_max=3150)}
OLD_ZEROS, NEW_ZEROS = {ELBOW: Zero(by="stops", angle=-0.1)}, {ELBOW: Zero(by="pose", angle=0.2)}


def enter(folder):
    """Let ``folder`` hold the module's data and the second copies; the file's path."""
    os.environ["VIAM_MODULE_DATA"] = str(folder / "module")
    os.environ["XDG_DATA_HOME"] = str(folder / "home")
    return folder / "module" / "arm.json"


def prepare(file, what):
    store.save(file, OLD, zeros=OLD_ZEROS)
    if what == "restore":
        store.save(file, NEW, zeros=NEW_ZEROS)
    if what == "load":
        for path in file.parent.iterdir():
            path.unlink()


def act(file, what):
    if what == "save":
        store.save(file, NEW, zeros=NEW_ZEROS)
    elif what == "restore":
        store.restore(file)
    else:
        store.load(file)


def main(base, what):
    from dying import dies_at  # it lies beside this script

    os.fsync = lambda _: None  # a process that dies takes nothing with it; only computers do
    for step in itertools.count():
        folder = base / str(step)
        file = enter(folder)
        prepare(file, what)
        child = os.fork()
        if child == 0:
            dies_at(step, folder)
            act(file, what)
            os._exit(0)
        if os.WIFEXITED(os.waitpid(child, 0)[1]):
            return


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
