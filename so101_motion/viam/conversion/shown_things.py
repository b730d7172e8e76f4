"""The ids of the transforms in ``devrel:so101:world-state``, to recognise our own."""

from __future__ import annotations

import uuid

from viam.proto.common import Transform

_NAMESPACE = uuid.UUID("8f3b1b5e-6a0c-4d8e-9d38-5a0f1f1c9a51")


def shown_id(frame: str, label: str) -> bytes:
    return uuid.uuid5(_NAMESPACE, f"{frame}/{label}").bytes


def is_ours(thing: Transform) -> bool:
    """Whether this module shows the transform: the arm's own scene, a goal, a path."""
    frame = thing.pose_in_observer_frame.reference_frame
    return thing.uuid == shown_id(frame, thing.reference_frame)
