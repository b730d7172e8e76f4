"""A call that runs in a process of its own."""

import os
import threading
import time

import pytest

from so101_motion.common.child_process import OwnProcess
from so101_motion.common.errors import WorkerError
from so101_motion.common.units import to_deg


def test_another_process_computes_and_its_exception_or_its_end_is_raised_here():
    assert OwnProcess().call(os.getpid) != os.getpid()
    with pytest.raises(TypeError, match="str"):
        OwnProcess().call(to_deg, "much")
    with pytest.raises(WorkerError, match="code 3"):
        OwnProcess().call(os._exit, 3)


def test_nobody_waits_for_what_was_cancelled():
    computing, ended = OwnProcess(), []

    def wait():
        try:
            computing.call(time.sleep, 600.0)
        except WorkerError as error:
            ended.append(str(error))

    waiting = threading.Thread(target=wait)
    waiting.start()
    computing.kill()
    waiting.join(timeout=60.0)
    assert ended == ["the computation was cancelled"]
