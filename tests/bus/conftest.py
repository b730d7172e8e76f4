"""An arm on a wire: the real rig and driver, the emulated servos, and one clock for all.

The pseudo-terminal is real and so are its microseconds; everything slower follows the clock, which
a test moves by hand. Replies come at once unless a test asks for lateness. The options of a bench
are those of ``emulated`` marks.
"""

import pytest
from harness.emulated_rig import ModelBench, hardware_bench


@pytest.fixture(autouse=True)
def own_home(tmp_path, monkeypatch):
    """What is saved goes to a folder of the test, and no port is taken unasked."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.delenv("SO101_PORT", raising=False)


@pytest.fixture
def options(request):
    marks = [mark.kwargs for mark in request.node.iter_markers("emulated")]
    return {name: value for mark in reversed(marks) for name, value in mark.items()}


@pytest.fixture
def bench(options, tmp_path, planning_process):
    with hardware_bench(tmp_path, **options) as bench:
        yield bench


@pytest.fixture
async def models(options, tmp_path, planning_process):
    """With components that are talked to as viam-server does."""
    bench = ModelBench(tmp_path, **options)
    yield bench
    await bench.end()
