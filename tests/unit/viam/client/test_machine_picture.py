"""Pictures of a machine's camera, over gRPC."""

import pytest
from harness.fake_camera import FakeCamera
from harness.in_process_module import client_of
from harness.web_camera import jpeg
from viam.media.video import CameraMimeType, NamedImage
from viam.proto.common import ResponseMetadata

from so101_motion.common.errors import ConfigError
from so101_motion.viam.client.machine import picture_of


class Changing(FakeCamera):
    """Sends a raw picture and a JPEG that differs from the one before."""

    kinds = (CameraMimeType.VIAM_RGBA, CameraMimeType.JPEG)

    async def get_images(self, **kwargs):
        self.looks += 1
        images = [NamedImage("", jpeg(self.looks), kind) for kind in self.kinds]
        return images, ResponseMetadata()


async def test_a_picture_is_a_jpeg_and_the_next_one_another():
    camera = Changing("top", None)
    async with client_of(camera) as client:
        assert [await picture_of(client) for _ in range(2)] == [jpeg(1), jpeg(2)]
        camera.kinds = (CameraMimeType.VIAM_RGBA,)
        with pytest.raises(ConfigError, match="neither JPEG nor PNG"):
            await picture_of(client)
