#!/bin/sh
# viam-sdk 0.85.1: a component that has no value for a joint (None) answers its own client, in one process.
#
# Expected: None in every answer: a joint that did not reply has no position.
# Seen: readings give None, do_command gives 0, which is a valid angle, for the same dictionary.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet viam-sdk==0.85.1
"$folder/venv/bin/python" - <<'PY'
import asyncio

from grpclib.testing import ChannelFor
from viam.components.sensor import Sensor, SensorClient
from viam.components.sensor.service import SensorRPCService
from viam.resource.manager import ResourceManager


JOINTS = {"elbow_deg": 30, "wrist_deg": None}


class Joints(Sensor):
    async def get_readings(self, **kwargs):
        return JOINTS

    async def do_command(self, command, **kwargs):
        return JOINTS


async def main():
    service = SensorRPCService(ResourceManager([Joints("joints")]))
    async with ChannelFor([service]) as channel:
        client = SensorClient("joints", channel)
        readings, answer = await client.get_readings(), await client.do_command({"joints": True})
    print(f"wrist: sent None, read {readings['wrist_deg']}, answered {answer['wrist_deg']}")
    assert readings["wrist_deg"] is None
    assert answer["wrist_deg"] == 0
    assert answer["wrist_deg"] is not None


asyncio.run(main())
PY
