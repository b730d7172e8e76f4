"""A process that calibrates the arm on a port, a step at a time, and can be killed at any instant.

    calibrating_process.py PORT FILE

It forks for each calibration, which saves the time of starting anew, and announces the fork's id.
Then each line it reads is a step, and each line it writes says how far it is. When the fork has
ended, by whatever means, it says so and is ready for the next.
"""

import os
import sys
from pathlib import Path
from threading import Event

from so101_motion.calib.procedure.session import Session
from so101_motion.rig.hardware_rig import open_hardware
from so101_motion.rig.servo_driver import ServoSettings

PATIENCE = 0.2
"""Above what a busy machine takes to run the emulator's thread [s]."""


def say(what):
    sys.stdout.write(f"{what}\n")
    sys.stdout.flush()


def look(session, _):
    """Wait until the joints have been read a few times more."""
    seen = session.view.samples
    while session.view.samples < seen + 5:
        Event().wait(0.005)


STEPS = {
    "start": lambda session, loan: session.start(loan),
    "set_homing": lambda session, _: session.set_homing(),
    "start_recording": lambda session, _: session.start_recording(),
    "look": look,
    "stop_recording": lambda session, _: session.stop_recording(),
    "save": lambda session, _: session.save(),
}


def calibrate(port, file):
    settings = ServoSettings(port=port, timeout=0.0, calibration_file=file)
    with (
        open_hardware(settings, reply_timeout=PATIENCE) as rig,
        rig.lend_bus("calibration") as loan,
    ):
        session = Session(file)
        for line in sys.stdin:
            STEPS[line.strip()](session, loan)
            say(session.view.state.value)


def main():
    port, file = sys.argv[1], Path(sys.argv[2])
    while sys.stdin.readline():
        child = os.fork()
        if child == 0:
            say(os.getpid())
            calibrate(port, file)
            return
        os.waitpid(child, 0)
        say("gone")


if __name__ == "__main__":
    main()
