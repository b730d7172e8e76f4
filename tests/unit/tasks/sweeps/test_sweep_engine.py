"""A sweep gives the same result on any executor, and resumes after any interruption."""

import itertools
import json
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace

import pytest
from harness.dying import Death
from harness.toy_sweep import ToySweep

from so101_motion.common.errors import ConfigError, WorkerError
from so101_motion.tasks.sweeps import run_sweep

TOY = ToySweep()


class Backwards(Executor):
    """Computes what was handed in last first, and only when somebody has waited for it."""

    def __init__(self, count):
        self._count, self._waiting = count, []

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        self._waiting.append((future, fn, args))
        if len(self._waiting) == self._count:
            while self._waiting:
                future_of, call, given = self._waiting.pop()
                future_of.set_result(call(*given))
        return future


class Broken(Executor):
    """Loses everything."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_exception(RuntimeError("no such computer"))
        return future


@pytest.fixture
def whole(tmp_path):
    return run_sweep(TOY, tmp_path / "whole")


def manifest(folder):
    return json.loads((folder / "sweep.json").read_text())


def files(folder):
    return {path.name: path.read_bytes() for path in (folder / "shards").iterdir()}


def test_the_result_does_not_depend_on_who_computes_in_which_order(tmp_path, whole):
    back = run_sweep(TOY, tmp_path / "back", executor=Backwards(TOY.shards), ahead=TOY.shards)
    with ThreadPoolExecutor(3) as threads:
        many = run_sweep(TOY, tmp_path / "many", executor=threads)
    assert back.sha256 == many.sha256 == whole.sha256
    assert files(tmp_path / "back") == files(tmp_path / "many") == files(whole.folder)
    assert run_sweep(replace(TOY, seed=1), tmp_path / "other").sha256 != whole.sha256


def test_a_damaged_shard_is_computed_again(whole):
    file = whole.folder / "shards" / "000002.npz"
    data = bytearray(file.read_bytes())
    data[len(data) // 3] ^= 0xFF
    file.write_bytes(data)
    again = run_sweep(TOY, whole.folder)
    assert (again.computed, again.sha256) == (1, whole.sha256)


def test_a_shard_that_fails_says_why_and_the_others_go_on(tmp_path):
    mended = tmp_path / "mended"
    sweep = replace(TOY, fails=(1, 3), mended=str(mended))
    first = run_sweep(sweep, tmp_path / "out")
    assert set(first.failed) == {1, 3}
    assert first.computed == 3
    assert "is not what it should be" in manifest(tmp_path / "out")["failed"]["3"]
    mended.touch()
    second = run_sweep(sweep, tmp_path / "out")
    assert not second.failed
    assert second.computed == 2
    assert second.sha256 != first.sha256
    assert run_sweep(sweep, tmp_path / "other").sha256 == second.sha256


def test_ctrl_c_keeps_what_is_done(tmp_path, whole):
    def interrupt(progress):
        if progress.done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_sweep(TOY, tmp_path / "out", on_progress=interrupt)
    assert manifest(tmp_path / "out")["done"] == 2
    assert manifest(tmp_path / "out")["sha256"] is None
    again = run_sweep(TOY, tmp_path / "out")
    assert (again.computed, again.sha256) == (3, whole.sha256)


def test_progress_counts_up_and_tells_rate_and_time_left(tmp_path):
    seconds = iter(range(100))
    told = []
    run_sweep(TOY, tmp_path / "out", on_progress=told.append, now=lambda: float(next(seconds)))
    assert [each.done for each in told] == [1, 2, 3, 4, 5]
    assert [each.rate for each in told] == [10.0] * 5
    assert [each.left for each in told] == [4.0, 3.0, 2.0, 1.0, 0.0]


def test_the_folder_of_another_sweep_or_with_other_things_is_refused(whole, tmp_path):
    with pytest.raises(ConfigError, match="another sweep: its seed is 0, and 7 is asked for"):
        run_sweep(replace(TOY, seed=7), whole.folder)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "letter.txt").touch()
    with pytest.raises(ConfigError, match="holds other things"):
        run_sweep(TOY, tmp_path / "other")
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["letter.txt"]


def test_an_executor_that_loses_everything_is_given_up(tmp_path):
    with pytest.raises(WorkerError, match=r"no such computer.*to go on"):
        run_sweep(TOY, tmp_path / "out", executor=Broken())


def test_a_run_that_is_killed_at_any_step_resumes(tmp_path):
    """At each file that it writes; ``benchmarks/bench_kills.py`` kills processes by time."""
    sweep = replace(TOY, shards=3)
    whole = run_sweep(sweep, tmp_path / "whole")
    for step in itertools.count():
        folder = tmp_path / str(step)
        died = Death(folder).comes(step, lambda folder=folder: run_sweep(sweep, folder))
        assert run_sweep(sweep, folder).sha256 == whole.sha256
        if not died:
            break
    assert step > 15


def test_a_killed_worker_is_replaced_and_a_shard_that_kills_is_found(tmp_path):
    sweep = replace(TOY, shards=3)
    mine = run_sweep(replace(sweep, kills=(1,)), tmp_path / "out", workers=2)
    assert set(mine.failed) == {1}
    assert "died" in mine.failed[1]
    expected = files(run_sweep(sweep, tmp_path / "whole").folder)
    del expected["000001.npz"]
    assert files(mine.folder) == expected
