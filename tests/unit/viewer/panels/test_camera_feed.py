"""A camera on a real socket of this machine, in its two usual forms."""

from base64 import b64decode

import pytest
from harness.viam_machine import until_true
from harness.web_camera import WebCamera, jpeg, web_camera
from so101_viewer.panels.camera_panel import CameraFeed

from so101_motion.common.errors import ConfigError, MachineRefused


@pytest.fixture(scope="module")
def address():
    with web_camera() as address:
        yield address


@pytest.mark.parametrize("path", ["/picture", "/stream"])
def test_pictures_come_one_after_the_other(address, path):
    feed = CameraFeed(address + path)
    until_true(lambda: feed.picture is not None)
    first = feed.picture
    assert first is not None
    assert first.url.startswith("data:image/jpeg;base64,/9j/")
    assert b64decode(first.url.partition(",")[2]).endswith(b"\xff\xd9")
    if path == "/picture":
        until_true(lambda: feed.picture is not first)
    else:
        until_true(lambda: feed.problem == "the stream has ended")
    feed.close()


@pytest.mark.parametrize(("path", "says"), [("/lost", "503"), ("/page", "no picture")])
def test_what_is_wrong_is_reported(address, path, says):
    feed = CameraFeed(address + path)
    until_true(lambda: says in feed.problem)
    assert feed.picture is None
    feed.close()


def test_nothing_is_fetched_while_nobody_looks(address):
    before, asked = WebCamera.count, []
    feed = CameraFeed(f"{address}/picture", wanted=lambda: bool(asked.append(1)))
    until_true(lambda: asked)
    feed.close()
    assert WebCamera.count == before


def test_a_machines_camera_is_asked_by_its_name_and_what_it_refuses_is_reported():
    pictures = [jpeg(1), jpeg(2)]

    def ask(name):
        if not pictures:
            raise MachineRefused(f"{name}: picture", "UNKNOWN", "the lens is closed")
        return pictures.pop(0)

    feed = CameraFeed("top", ask=ask)
    until_true(lambda: "the lens is closed" in feed.problem)
    assert feed.picture is not None
    assert not pictures
    feed.close()
    with pytest.raises(ConfigError, match="or the name of a camera of the machine"):
        CameraFeed("a/b", ask=ask)


@pytest.mark.parametrize("url", ["/dev/", "file:///etc/passwd", "camera", "http://", "ftp://a/b"])
def test_only_web_addresses_are_taken_and_a_device_is_told_what_serves_its_pictures(url):
    with pytest.raises(ConfigError):
        CameraFeed(url)
    with pytest.raises(ConfigError, match="ustreamer --device"):
        CameraFeed("/dev/video0")
